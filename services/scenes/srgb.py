"""From display values to linear radiance."""

import numpy as np

from services.scenes.mesh import Doubles


def to_linear(display: Doubles) -> Doubles:
    """Linear values of sRGB display values in [0,1]: the inverse sRGB curve (IEC 61966-2-1). Any shape."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
