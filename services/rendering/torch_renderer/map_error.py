"""Measures the error of the environment map's resolution: its shading sum against that of a finer map."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from services.rendering.torch_renderer.error_estimates import subset
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader, Sky, Surface, displayed_error

PIXELS = 256
"""Maximum number of pixels of each object that are shaded under both maps."""


@torch.no_grad()
def map_error(surfaces: Sequence[Surface], own: tuple[Sky, Tensor], finest: tuple[Sky, Tensor]) -> float:
    """Returns the largest difference of displayed values between a scene under its `own` map and under the `finest`.

    Each map is given as a sky and its intensities [D], with its own exposure. Both are summed in float32, whose error
    is a thousandth of the differences of interest.
    """
    largest = 0.0
    for surface in surfaces:
        sample = subset(surface, PIXELS)
        if not len(sample.angles):
            continue
        shaded, truth = (_summed(sample, *light) for light in (own, finest))
        largest = max(largest, displayed_error(shaded, truth, sample.base_color))
    return largest


def _summed(surface: Surface, sky: Sky, intensity: Tensor) -> Tensor:
    """Returns the surface's radiance [P, 3], float64."""
    shader = Shader(replace(exact_recipe(sky), dtype=torch.float32), sky, surface, intensity)
    return shader(surface.angles, intensity, surface.material).double()
