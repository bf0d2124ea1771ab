"""Measures the error of the environment map's resolution: its shading sum against that of a finer map."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from services.rendering.torch_renderer.error_estimates import stride, subset
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader, Sky, Surface, displayed_error

PIXELS = 256
"""Maximum number of pixels of each object that are shaded under both maps."""


def looked_at(counts: Sequence[int]) -> Tensor:
    """Returns the indices of the pixels that are shaded, int64, in a list of all pixels region by region. `counts` are
    the numbers of pixels of the regions."""
    first, found = 0, [torch.zeros(0, dtype=torch.int64)]
    for count in counts:
        found.append(torch.arange(first, first + count)[:: stride(count, PIXELS)])
        first += count
    return torch.cat(found)


@torch.no_grad()
def map_error(
    surfaces: Sequence[Surface], own: tuple[Sky, Tensor], finest: tuple[Sky, Tensor], seen: Tensor | None = None
) -> float:
    """Returns the largest difference of displayed values between a scene under its `own` map and under the `finest`.

    The light of an object's layers is added up first: `surfaces` of one object have the same pixels, of which the same
    ones are looked at. Each map is given as a sky and its intensities [D], with its own exposure. Both are summed in
    float32, whose error is a thousandth of the differences of interest.

    With shadows, `surfaces` have the visibility of their own map's texels, and `seen` uint8 [D of the finest map, P] is
    that of the finest map's texels from the pixels that `looked_at` names.
    """
    objects: dict[str, list[Surface]] = {}
    for surface in surfaces:
        if len(surface.angles):
            objects.setdefault(surface.name, []).append(subset(surface, PIXELS))
    worst, first = 0.0, 0
    for parts in objects.values():
        last = first + len(parts[0].angles)
        under_finest = [replace(part, visibility=None if seen is None else seen[:, first:last]) for part in parts]
        shaded, truth = (
            torch.stack([_summed(part, *light) for part in shown]).sum(0)
            for shown, light in ((parts, own), (under_finest, finest))
        )
        worst, first = max(worst, displayed_error(shaded, truth, torch.ones_like(truth))), last
    return worst


def _summed(surface: Surface, sky: Sky, intensity: Tensor) -> Tensor:
    """Returns the surface's radiance times its base colour [P, 3], float64."""
    shader = Shader(replace(exact_recipe(sky, surface.material.shape[1]), dtype=torch.float32), sky, surface, intensity)
    return shader(surface.angles, intensity, surface.material).double() * surface.base_color
