"""Computes the directions and solid angles of an environment map's texels.

Row i is the polar angle θ = (i + ½)π/rows from +y, column j the azimuth φ = (j + ½)2π/cols about +y, from +z towards
+x, so the direction is (sin θ sin φ, cos θ, sin θ cos φ). Flat order is row by row.
"""

from math import pi

import torch
from torch import Tensor


def directions(rows: int, cols: int) -> Tensor:
    """Returns unit vectors towards the texel centres in world space, float64 [rows·cols, 3]."""
    polar = (torch.arange(rows, dtype=torch.float64) + 0.5) * (pi / rows)
    azimuth = (torch.arange(cols, dtype=torch.float64) + 0.5) * (2 * pi / cols)
    theta, phi = torch.meshgrid(polar, azimuth, indexing="ij")
    vectors = torch.stack((theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos()), dim=-1)
    return vectors.reshape(-1, 3)


def solid_angles(rows: int, cols: int) -> Tensor:
    """Returns the solid angle of each texel in steradians, float64 [rows·cols]; they sum to 4π."""
    edges = (torch.arange(rows + 1, dtype=torch.float64) * (pi / rows)).cos()
    return ((edges[:-1] - edges[1:]) * (2 * pi / cols)).repeat_interleave(cols)
