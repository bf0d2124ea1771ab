"""The environment map as the torch renderer uses it: directions and solid angles of its texels, intensities, fixed
colours, an exposure.

Row i is the polar angle θ = (i + ½)π/rows from +y, column j the azimuth φ = (j + ½)2π/cols about +y, from +z towards
+x, so the direction is (sin θ sin φ, cos θ, sin θ cos φ). Flat order is row by row.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN, WHITE


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


LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights that turn linear RGB into luminance (ITU-R BT.709)."""

LIGHT_GROUPS = ("illumination", "illumination_rgb")
"""The parameter groups that change the light."""

PROBES = (16, 32)
"""Rows and columns of the grid of surface normals among which the exposure finds the most lit."""


@dataclass(frozen=True)
class Illumination:
    """An environment map split into factors.

    The radiance of texel t is `exposure · chroma[t] · intensity[t]`, in displayed linear units.

    intensity: float64 [rows, cols], ≥ 0, mean over the sphere ILLUMINATION_MEAN (all zero for a black map).
    chroma: float64 [rows, cols, 3], the colour at luminance 1; white where the map is black.
    exposure: brings the most lit white Lambertian surface to WHITE in its brightest channel. It depends on the map
    only, never on the object or on a perturbation.
    """

    intensity: Tensor
    chroma: Tensor
    exposure: float


def illumination(environment: Tensor) -> Illumination:
    """Splits a map into its factors.

    `environment` is linear RGB radiance [rows, cols, 3], finite and ≥ 0, of any scale.
    """
    rows, cols, _ = environment.shape
    radiance = environment.to(torch.float64)
    # Divide by the maximum first, so that squares and sums of very large or very small maps stay in range.
    radiance = radiance / radiance.max().clamp_min(torch.finfo(torch.float64).tiny)
    luminance = radiance @ torch.tensor(LUMINANCE, dtype=torch.float64, device=radiance.device)
    lit = luminance > 0
    chroma = torch.where(lit[..., None], radiance / torch.where(lit, luminance, 1.0)[..., None], 1.0)
    angles = solid_angles(rows, cols).reshape(rows, cols).to(radiance.device)
    mean = float((luminance * angles).sum() / (4 * pi))
    intensity = luminance * (ILLUMINATION_MEAN / mean) if mean > 0 else luminance
    brightest = float(_white_surfaces(intensity, chroma).max())
    return Illumination(intensity, chroma, WHITE / (brightest or ILLUMINATION_MEAN))


def attacks_light(groups: Sequence[str]) -> bool:
    """Returns whether one of the groups changes the light."""
    return any(group in groups for group in LIGHT_GROUPS)


def _white_surfaces(intensity: Tensor, chroma: Tensor) -> Tensor:
    """Returns the radiance [surfaces, 3] of white Lambertian surfaces whose normals are the probe directions."""
    rows, cols = intensity.shape
    power = (chroma * intensity[..., None]).reshape(-1, 3) * solid_angles(rows, cols)[:, None].to(chroma.device)
    cosines = (directions(*PROBES) @ directions(rows, cols).T).clamp_min_(0.0).to(power.device)
    return cosines @ power / pi
