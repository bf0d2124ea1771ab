"""Fits a scene's parameters to an image: the smallest ℓ1 distance that gradient descent from the scene's values finds.

The parameters are those of a differentiable renderer, for the torch renderer normals, illumination and material.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from services.device import finite
from services.errors import JobFailure
from services.rendering.protocol import Parameters, Renderer

Optimiser = Literal["sgd", "adam"]


@dataclass(frozen=True)
class Fit:
    """The best of the fits that the optimiser went through."""

    perturbation: Parameters
    """The change from the scene's values that leads to it, by group."""
    losses: list[float]
    """Mean absolute difference of a displayed value at the start and after each step, [0,1]."""


def fit(
    renderer: Renderer, image: Tensor, optimiser: Optimiser, rate: float, steps: int, tick: Callable[[int], None]
) -> Fit:
    """Minimises ‖image − render(X₀ + ΔX)‖₁ over ΔX, from 0, by steps of one learning rate for all groups.

    ΔX has the groups for which the renderer is compiled. `image` is [H, W, 3] in [0,1], of the renderer's size. The
    norm is the sum over values, as in the paper; the units of the groups are those of the renderer. After each step the
    parameters are clamped to the renderer's bounds.
    `tick` is called before each image with the number of those rendered. Raises JobFailure("non-finite") if the
    distance or a gradient is not finite.
    """
    initial, bounds = renderer.initial(), renderer.bounds()
    start = {group: initial[group] for group in renderer.plan.groups}
    moved = {group: torch.zeros_like(value).requires_grad_() for group, value in start.items()}
    kind = torch.optim.SGD if optimiser == "sgd" else torch.optim.Adam
    stepper = kind(moved.values(), lr=rate)
    wanted, losses = image.to(torch.float64), list[float]()
    best: Parameters = {}
    for step in range(steps + 1):
        tick(step)
        with torch.set_grad_enabled(step < steps):
            [shown] = renderer.render({group: (start[group] + moved[group])[None] for group in moved})
            distance = (shown.double() - wanted.to(shown.device)).abs().sum()
        losses.append(float(distance.detach()) / image.numel())
        if not finite(distance):
            raise JobFailure("non-finite", "the distance of a fit is not finite")
        if losses[-1] == min(losses):
            best = {group: value.detach().clone() for group, value in moved.items()}
        if step == steps:
            break
        stepper.zero_grad()
        distance.backward()
        if not all(value.grad is None or finite(value.grad) for value in moved.values()):
            raise JobFailure("non-finite", "the gradient of a fit has values that are not finite")
        stepper.step()
        with torch.no_grad():
            for group, value in moved.items():
                low, high = bounds[group]
                value.clamp_(low - start[group], high - start[group])
    return Fit(best, losses)
