"""Measures the gradient error of a recipe against the exact float64 sum, when the plan is made."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from services.rendering.color import to_display
from services.rendering.plan import GradientError
from services.rendering.torch_renderer.error_estimates import spread, subset
from services.rendering.torch_renderer.shader import Recipe, Shader, Sky, Surface

PAIRS = 2**18
"""Maximum number of pixels times directions whose gradient is measured: 512 pixels under a map of 16×32."""


@torch.enable_grad()
def gradient_errors(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe, exact: Recipe
) -> list[GradientError]:
    """Measures the error of each attacked group's gradient at a sample of a surface's pixels, in the order of `groups`.

    The gradient is that of a sum of the displayed values with normally distributed random weights. This is harsher than
    a network, whose weights are smooth: errors of neighbouring pixels do not cancel. The displayed values of a layer
    are those of the layer alone. The list is empty where nothing is attacked or no light reaches the surface.
    """
    random = torch.Generator().manual_seed(2)
    max_pixels = max(16, PAIRS // sky.power.shape[1])
    sample = subset(surface, max_pixels)
    if surface.viewers is None:
        sample = subset(spread(sample, "normals" in groups, random), max_pixels)
    weights = torch.randn(len(sample.angles), 3, generator=random, dtype=torch.float64).to(sample.angles.device)
    values = {"normals": sample.angles, "illumination": illumination, "material": sample.material}
    if "illumination_rgb" in groups:
        values["illumination_rgb"] = illumination.new_zeros(3, len(illumination))
    found = []
    for compared in (replace(recipe, guard=None), exact):
        leaves = {
            name: value.to(compared.dtype, copy=True).requires_grad_(name in groups) for name, value in values.items()
        }
        shader = Shader(compared, sky, sample, illumination)
        light = leaves["illumination"]
        if "illumination_rgb" in leaves:
            light = light + leaves["illumination_rgb"]
        radiance = shader(leaves["normals"], light, leaves["material"])
        displayed = to_display(radiance * sample.base_color.to(compared.dtype))
        total = (displayed * weights.to(compared.dtype)).sum()
        if not total.requires_grad:  # nothing is attacked, or no light reaches the surface whatever is changed
            return []
        found.append(torch.autograd.grad(total, [leaves[name] for name in groups], materialize_grads=True))
    return [
        GradientError(part=surface.with_layer(surface.name), group=group, **_compared(value.double(), truth))
        for group, value, truth in zip(groups, *found, strict=True)
    ]


def _compared(value: Tensor, truth: Tensor) -> dict[str, float]:
    """Returns the relative L2 error, and the share of wrong signs among the coordinates whose gradient is not zero."""
    length = float(truth.norm())
    if length == 0.0:
        return {"relative": 0.0, "wrong_signs": 0.0}
    there = truth != 0
    wrong = (value.sign() != truth.sign()) & there
    return {
        "relative": float((value - truth).norm()) / length,
        "wrong_signs": float(wrong.sum()) / float(there.sum()),
    }
