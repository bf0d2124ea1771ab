"""The architectures of published and of trained networks, as plain torch modules."""
