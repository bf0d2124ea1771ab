"""Measurements of accuracy: error against run time, errors during whole attacks, and stability on extreme cases."""
