"""What the environment map's resolution costs: the sum over its texels against the sum over finer ones."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from services.rendering.torch_renderer.error_estimates import subset
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader, Sky, Surface, displayed_error

PIXELS = 256
"""Pixels of each object that are summed over both maps, at most."""


@torch.no_grad()
def map_error(surfaces: Sequence[Surface], own: tuple[Sky, Tensor], finest: tuple[Sky, Tensor]) -> float:
    """The largest difference of displayed values between a scene under its `own` map and under the `finest`, each given
    as a sky and its intensities [D], with the exposure that belongs to it.

    Both are summed in float32, whose error is thousandths of what is looked for.
    """
    largest = 0.0
    for surface in surfaces:
        some = subset(surface, PIXELS)
        if not len(some.angles):
            continue
        shaded, truth = (_summed(some, *light) for light in (own, finest))
        largest = max(largest, displayed_error(shaded, truth, some.base_color))
    return largest


def _summed(surface: Surface, sky: Sky, intensity: Tensor) -> Tensor:
    """Radiance [P, 3], float64."""
    shader = Shader(replace(exact_recipe(sky), dtype=torch.float32), sky, surface, intensity)
    return shader(surface.angles, intensity, surface.material).double()
