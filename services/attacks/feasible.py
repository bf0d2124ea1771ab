"""The perturbations that an attack may use: bounds by group, random starts within them, and backtracking to U.

A method sees one box for each group (`AttackProblem.bounds`), the intersection of the renderer's physical bounds, the
request's `bounds` and ε. `AttackProblem.clamp` projects onto it, so no method knows which limit it was.
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from services.attacks.seeds import generator
from services.errors import InvalidRequest
from services.rendering.protocol import BOUND_SLACK, Parameters

Box = tuple[Tensor, Tensor]
"""Smallest and largest perturbation of a group, broadcastable to it."""

HALVINGS = 8
"""Backtracking finds the largest feasible scale to 1/256."""
BACKTRACK_MARGIN = 0.5 / 255
"""Backtracking keeps this distance from U: the plan's error may take the exact image as far from the loop's."""
P_MARGIN = 0.01
"""Backtracking keeps p below its limit by this share, for the same reason."""
ROUNDING = 1e-6
"""Tolerance of the comparison with U: float32 sums of k/255 are off by less, and a change of exactly U is allowed."""


def perturbation_bounds(
    initial: Mapping[str, Tensor],
    physical: Mapping[str, Box],
    bounds: Mapping[str, tuple[float, float]],
    epsilon: Mapping[str, float],
) -> dict[str, Box]:
    """Smallest and largest perturbation of each group that has any limit.

    `initial` are the attacked groups' values, `physical` the renderer's bounds of the values, `bounds` the request's,
    and `epsilon` the largest change, each by group. Raises InvalidRequest("attack.bounds.<group>") if the request's
    bounds exclude a value of `initial`.
    """
    found = {}
    for group, value in initial.items():
        low, high = (bound.to(value.dtype) - value for bound in physical[group])
        if group in bounds:
            _check_start(group, value, bounds[group])
            low, high = low.clamp_min(bounds[group][0] - value), high.clamp_max(bounds[group][1] - value)
            # rounding, and the slack of the check, must not exclude the start itself
            low, high = low.clamp_max(0.0), high.clamp_min(0.0)
        if group in epsilon:
            low, high = low.clamp_min(-epsilon[group]), high.clamp_max(epsilon[group])
        if not bool(low.isinf().all() and high.isinf().all()):
            found[group] = (low, high)
    return found


def _check_start(group: str, value: Tensor, bounds: tuple[float, float]) -> None:
    low, high = bounds
    beyond = torch.maximum(low - value, value - high)
    if bool((beyond > BOUND_SLACK * (1 + value.abs())).any()):
        outside = float(value.flatten()[beyond.argmax()])
        raise InvalidRequest(
            f"attack.bounds.{group}",
            f"they exclude the start: the scene itself has a value of {outside:g}, not within {low:g} to {high:g}",
        )


def random_start(initial: Mapping[str, Tensor], bounds: Mapping[str, Box], seed: int, restart: int) -> Parameters:
    """A uniformly random perturbation within `bounds`, which are finite for each group of `initial`."""
    start = {}
    for group, value in initial.items():
        low, high = bounds[group]
        share = torch.rand(value.shape, generator=generator(seed, "start", group, restart), dtype=torch.float64)
        start[group] = (low + (high - low) * share).to(value.dtype)
    return start


def pulled_back(fits: Callable[[Tensor], Tensor], vectors: Tensor) -> Tensor:
    """Scales each perturbation of `vectors` [B, total] by the largest factor, to 1/256, with which it `fits`.

    `fits` maps perturbations [n, total] to bool [n], and is true of 0. Bisection keeps a factor that fits, so the
    result fits also where larger factors fit again. Vectors that fit are returned as they are.
    """
    yes = fits(vectors)
    if bool(yes.all()):
        return vectors
    which = (~yes).nonzero()[:, 0]
    low, high = torch.zeros(len(which), 1, dtype=vectors.dtype), torch.ones(len(which), 1, dtype=vectors.dtype)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        inside = fits(middle * vectors[which])[:, None]
        low, high = torch.where(inside, middle, low), torch.where(inside, high, middle)
    found = vectors.clone()
    found[which] = low * vectors[which]
    return found


def within(image: Tensor, original: Tensor, limit: float | None, perceptibility: float | None) -> bool:
    """Whether no value of an image [1, H, W, 3] is further than `limit` from the original, and its p is not above
    `perceptibility`, both less the margin that backtracking keeps; None is no limit.
    """
    change = image - original
    if limit is not None and float(change.abs().max()) > limit - BACKTRACK_MARGIN + ROUNDING:
        return False
    p = float(change.double().square().sum(-1).mean().sqrt())
    return perceptibility is None or p <= (1 - P_MARGIN) * perceptibility
