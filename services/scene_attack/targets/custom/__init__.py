"""Networks that users bring: one folder each, with a card and a model file, an allow-listed factory or an address."""
