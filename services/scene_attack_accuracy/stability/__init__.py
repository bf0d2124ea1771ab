"""Stiff and extreme cases: the property that must hold in each, and the measured result."""
