"""What a recipe costs in accuracy of gradients: measured when the plan is made, against the exact sum's in float64."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from services.rendering.color import to_display
from services.rendering.plan import GradientError
from services.rendering.torch_renderer.error_estimates import spread, subset
from services.rendering.torch_renderer.shader import Recipe, Shader, Sky, Surface

PAIRS = 2**18
"""Pixels times directions whose gradient is measured, at most: 512 pixels under a map of 16×32."""


@torch.enable_grad()
def gradient_errors(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe, exact: Recipe
) -> list[GradientError]:
    """The error of each attacked group's gradient at some pixels of a surface, in the order of `groups`.

    The gradient is that of the displayed values, each weighted by a random normal number: harsher than a network, whose
    weights are smooth, so that neighbours' errors do not cancel there.
    """
    random = torch.Generator().manual_seed(2)
    most = max(16, PAIRS // sky.power.shape[1])
    some = subset(surface, most)
    if surface.viewers is None:
        some = subset(spread(some, "normals" in groups, random), most)
    weights = torch.randn(len(some.angles), 3, generator=random, dtype=torch.float64).to(some.angles.device)
    values = {"normals": some.angles, "illumination": illumination, "material": some.material}
    found = []
    for one in (replace(recipe, guard=None), exact):
        leaves = {name: value.to(one.dtype, copy=True).requires_grad_(name in groups) for name, value in values.items()}
        shader = Shader(one, sky, some, illumination)
        radiance = shader(leaves["normals"], leaves["illumination"], leaves["material"])
        shown = to_display(radiance * some.base_color.to(one.dtype))
        total = (shown * weights.to(one.dtype)).sum()
        if not total.requires_grad:  # nothing is attacked, or no light reaches the surface whatever is changed
            return []
        found.append(torch.autograd.grad(total, [leaves[name] for name in groups], materialize_grads=True))
    return [
        GradientError(part=surface.name, group=group, **_compared(value.double(), truth))
        for group, value, truth in zip(groups, *found, strict=True)
    ]


def _compared(value: Tensor, truth: Tensor) -> dict[str, float]:
    """Relative L2 error, and the share of wrong signs among the coordinates whose gradient is not zero."""
    length = float(truth.norm())
    if length == 0.0:
        return {"relative": 0.0, "wrong_signs": 0.0}
    there = truth != 0
    wrong = (value.sign() != truth.sign()) & there
    return {
        "relative": float((value - truth).norm()) / length,
        "wrong_signs": float(wrong.sum()) / float(there.sum()),
    }
