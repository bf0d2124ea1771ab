"""A camera between the scene and the network: how it takes an image, and the renderer that attacks its settings."""
