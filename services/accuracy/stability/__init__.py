"""Stiff and extreme cases: what must hold of each, and what was seen."""
