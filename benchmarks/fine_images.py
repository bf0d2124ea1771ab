"""Images that are drawn larger and averaged, for comparisons of what two renderers make of edges and small texels.

Light is averaged, and not displayed values: each image becomes linear first. All displayed values are 255 times the
coverage times linear light, clipped to [0,1], to the power of 1 / 2.2, as stock pyrender displays it on black ground.
"""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Light = NDArray[np.float64]
GAMMA = 2.2


def light(shown: Image, covered: NDArray[np.bool_]) -> Light:
    """Linear light times coverage, and coverage, [H, W, 4], of displayed values [H, W, 3] and where surfaces are."""
    there = covered[..., None].astype(np.float64)
    return np.concatenate([there * (shown / 255) ** GAMMA, there], axis=-1)


def averaged(fine: Light, factor: int) -> Light:
    """The means of blocks of `factor` × `factor` pixels of light [H, W, 4], each clipped first, as displays clip it."""
    coverage = fine[..., 3:]
    clipped = np.concatenate([np.clip(_surface(fine), 0, 1) * coverage, coverage], axis=-1)
    height, width = (side // factor for side in clipped.shape[:2])
    mean: Light = clipped.reshape(height, factor, width, factor, 4).mean(axis=(1, 3))
    return mean


def displayed(image: Light) -> Image:
    """The displayed values [H, W, 3] of light [H, W, 4]."""
    shown: Image = np.rint(255 * image[..., 3:] * np.clip(_surface(image), 0, 1) ** (1 / GAMMA)).astype(np.uint8)
    return shown


def blocks(shown: Image, side: int) -> Image:
    """The mean light of blocks of `side` × `side` pixels of displayed values, displayed again."""
    return displayed(averaged(light(shown, np.ones(shown.shape[:2], bool)), side))


def _surface(image: Light) -> Light:
    """The light of the surfaces alone, [H, W, 3]; 0 where there is none."""
    coverage = image[..., 3:]
    found: Light = np.divide(image[..., :3], coverage, out=np.zeros_like(image[..., :3]), where=coverage > 0)
    return found
