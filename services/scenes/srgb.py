"""Converts displayed sRGB values to linear values, and back."""

import numpy as np

from services.scenes.mesh import Doubles


def to_linear(display: Doubles) -> Doubles:
    """Returns the linear values of displayed sRGB values in [0,1], of any shape: the inverse curve of IEC 61966-2-1."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def to_display(linear: Doubles) -> Doubles:
    """Returns the displayed sRGB values of linear values of any shape, clipped to [0,1] (IEC 61966-2-1)."""
    clipped = linear.clip(0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
