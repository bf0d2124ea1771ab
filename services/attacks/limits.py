"""The perturbations that an attack may use: bounds by group, random starts within them, constraints, backtracking to U.

A method sees one box for each group (`AttackProblem.bounds`), the intersection of the renderer's physical bounds, the
request's `bounds` and ε. `AttackProblem.clamp` projects onto it, so no method knows which limit it was. `Layout` makes
one vector of all groups.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import inf, log
from typing import Protocol

import torch
from torch import Tensor

from services.attacks.seeds import generator
from services.errors import InvalidRequest
from services.rendering.protocol import BOUND_SLACK, Parameters


@dataclass(frozen=True)
class Layout:
    """The position of each group's coordinates in a vector of length `total`."""

    groups: tuple[str, ...]
    shapes: dict[str, torch.Size]
    starts: dict[str, int]
    total: int

    @classmethod
    def of(cls, values: Mapping[str, Tensor]) -> "Layout":
        """The layout of the groups in `values`, in their order."""
        starts, total = {}, 0
        for group, value in values.items():
            starts[group] = total
            total += value.numel()
        return cls(tuple(values), {g: v.shape for g, v in values.items()}, starts, total)

    def zeros(self, dtype: torch.dtype = torch.float32) -> Tensor:
        """A vector [total] of zeros."""
        return torch.zeros(self.total, dtype=dtype)

    def group_of(self, coordinate: int) -> str:
        """The group a coordinate of the vector belongs to."""
        return next(g for g in reversed(self.groups) if coordinate >= self.starts[g])

    def flatten(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """The groups' values, each of its group's shape, as one vector [total]."""
        return torch.cat([parameters[g].flatten() for g in self.groups])

    def unflatten(self, vectors: Tensor) -> Parameters:
        """Vectors [..., total] as tensors [..., *shape], by group."""
        lead = vectors.shape[:-1]
        return {
            g: vectors[..., self.starts[g] : self.starts[g] + self.shapes[g].numel()].reshape(*lead, *self.shapes[g])
            for g in self.groups
        }

    def spread(self, by_group: Mapping[str, float]) -> Tensor:
        """A vector, float64 [total], in which every coordinate has its group's value."""
        return torch.cat([torch.full((self.shapes[g].numel(),), by_group[g], dtype=torch.float64) for g in self.groups])

    def mask(self, coordinates: Iterable[tuple[str, int]]) -> Tensor:
        """A mask, bool [total], that is true at the given (group, flat index within the group)."""
        found = torch.zeros(self.total, dtype=torch.bool)
        found[[self.starts[group] + index for group, index in coordinates]] = True
        return found


Box = tuple[Tensor, Tensor]
"""Smallest and largest perturbation of a group, broadcastable to it."""

TRIES = 8
"""Scales that backtracking tries at most; two are usual."""
SLACK = 0.04
"""Backtracking is content with this share less than the limit."""
AIM = 1 - SLACK / 2
TINY = 0.05
"""Least part of the interval between a factor within and one beyond by which backtracking goes on."""
LEAST_POWER, MOST_POWER = 0.25, 4.0
"""Range of the exponent by which the change of an image grows with the perturbation."""
BACKTRACK_MARGIN = 0.5 / 255
"""Backtracking keeps this distance from U: the plan's error may take the exact image as far from the loop's."""
P_MARGIN = 0.01
"""Backtracking keeps p below its limit by this share, for the same reason."""
EDGE = 0.05
"""Share of ε within which a value counts as at it: a search by random draws ends near ε, hardly ever on it."""
ROUNDING = 1e-6
"""Tolerance of the comparison with U: float32 sums of k/255 are off by less, and a change of exactly U is allowed."""


class Constraint(Protocol):
    """What a scene allows beyond a box for each group, such as that objects do not overlap. The zero vector holds."""

    @property
    def fixed(self) -> Mapping[str, Tensor]:
        """Which coordinates stay as they are, bool of the shape of each attacked group."""
        ...

    def holds(self, perturbation: Parameters) -> bool:
        """Whether a perturbation is allowed."""
        ...

    def project(self, perturbation: Parameters) -> Parameters:
        """Returns a perturbation that is allowed: itself if it is, else one that is smaller."""
        ...


def held(bounds: Mapping[str, Box], constraint: Constraint | None) -> dict[str, Box]:
    """Returns bounds in which the coordinates that a constraint fixes are at 0."""
    found = dict(bounds)
    for group, mask in ({} if constraint is None else constraint.fixed).items():
        if bool(mask.any()):
            low, high = found.get(group, (torch.tensor(-inf), torch.tensor(inf)))
            zero = torch.zeros((), dtype=low.dtype)
            found[group] = (torch.where(mask, zero, low), torch.where(mask, zero, high))
    return found


def fixed(constraint: Constraint | None, layout: Layout) -> Tensor:
    """Returns a mask, bool [total], of the coordinates that a constraint fixes."""
    masks = {} if constraint is None else constraint.fixed
    of_groups = [masks.get(group, torch.zeros(layout.shapes[group], dtype=torch.bool)) for group in layout.groups]
    return torch.cat([mask.flatten() for mask in of_groups])


def projected(constraint: Constraint | None, layout: Layout, vectors: Tensor) -> Tensor:
    """Returns perturbations [B, total] projected to a constraint."""
    if constraint is None:
        return vectors
    found = [constraint.project(layout.unflatten(vector.detach())) for vector in vectors]
    return torch.stack([layout.flatten(one) for one in found])


def allowed(constraint: Constraint | None, layout: Layout, vectors: Tensor, instead: Tensor) -> Tensor:
    """Returns perturbations [B, total], with `instead` [total] in place of those that a constraint does not allow."""
    if constraint is None:
        return vectors
    return torch.stack([one if constraint.holds(layout.unflatten(one)) else instead.to(one.dtype) for one in vectors])


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


def at_epsilon(perturbation: Mapping[str, Tensor], epsilon: Mapping[str, float]) -> dict[str, Tensor]:
    """Which values of each group that has an ε are at it, within `EDGE`: bool, of the shape of the group."""
    return {group: perturbation[group].abs() >= (1 - EDGE) * limit for group, limit in epsilon.items()}


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


def pulled_back(reach: Callable[[Tensor], float], vectors: Tensor) -> Tensor:
    """Scales each perturbation of `vectors` [B, total] back until its reach is 1 at most, and close to it.

    `reach` maps a perturbation [total] to the part of the limit that its image takes: 0 for the zero vector, above 1
    beyond the limit. Vectors within it are returned as they are.
    """
    return torch.stack([_scale(reach, vector) * vector for vector in vectors])


def _scale(reach: Callable[[Tensor], float], vector: Tensor) -> float:
    """A factor in [0, 1] at which the reach is between 1 − `SLACK` and 1; the largest found to be within after `TRIES`.

    Changes of colour grow with the factor, those of moving silhouettes with its root. So the reach is taken as a power
    of the factor, whose exponent is that between the last two factors.
    """
    low, high, at_high, power = 0.0, 1.0, reach(vector), 1.0
    if at_high <= 1:
        return 1.0
    for _ in range(TRIES):
        tried = max(low + TINY * (high - low), high * (AIM / at_high) ** (1 / power))
        found = reach(tried * vector)
        if 0 < found < at_high:
            power = min(max(log(at_high / found) / log(high / tried), LEAST_POWER), MOST_POWER)
        if found > 1:
            high, at_high = tried, found
        else:
            low = tried
            if found >= 1 - SLACK or found == 0:
                break
    return low


def reached(image: Tensor, original: Tensor, limit: float | None, perceptibility: float | None) -> float:
    """The part of its limits that an image [1, H, W, 3] takes: of `limit` its largest change of a value, of
    `perceptibility` its p, whichever is more; both less the margin that backtracking keeps. None is no limit.
    """
    change = image - original
    parts = [0.0]
    if limit is not None:
        parts.append(float(change.abs().max()) / (limit - BACKTRACK_MARGIN + ROUNDING))
    if perceptibility is not None:
        p = float(change.double().square().sum(-1).mean().sqrt())
        parts.append(p / ((1 - P_MARGIN) * perceptibility))
    return max(parts)
