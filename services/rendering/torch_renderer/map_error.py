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

    That of an object with layers is the sum of theirs, which is a bound.

    Each map is given as a sky and its intensities [D], with its own exposure. Both are summed in float32, whose error
    is a thousandth of the differences of interest.
    """
    found: dict[str, float] = {}
    for surface in surfaces:
        sample = subset(surface, PIXELS)
        if not len(sample.angles):
            continue
        shaded, truth = (_summed(sample, *light) for light in (own, finest))
        error = displayed_error(shaded, truth, sample.base_color)
        found[surface.name] = found.get(surface.name, 0.0) + error  # the errors of an object's layers add up
    return max(found.values(), default=0.0)


def _summed(surface: Surface, sky: Sky, intensity: Tensor) -> Tensor:
    """Returns the surface's radiance [P, 3], float64."""
    shader = Shader(replace(exact_recipe(sky, surface.material.shape[1]), dtype=torch.float32), sky, surface, intensity)
    return shader(surface.angles, intensity, surface.material).double()
