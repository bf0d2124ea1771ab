"""The perturbations that an attack may use: bounds, a scene's constraint, U, and backtracking; and their vectors.

A perturbation is one vector of the changes of all attacked groups (`Layout`). An attack sees one box: the intersection
of the renderer's physical bounds, the request's `bounds` and ε. `Limits.clamp` projects onto it, so no attack knows
which limit it was.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import log
from typing import Protocol

import torch
from torch import Tensor

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.plan import Plan
from scene_attack.rendering.protocol import BOUND_SLACK, Parameters, Renderer

MAX_TRIES = 8
"""Largest number of scales that backtracking tries; two are usual."""
SLACK = 0.04
"""Backtracking is content with this share less than the limit."""
AIM = 1 - SLACK / 2
SMALLEST_STEP = 0.05
"""Smallest step of backtracking, as a share of the interval between a factor within the limit and one beyond."""
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


@dataclass(frozen=True)
class Layout:
    """The position of each group's coordinates in a vector of length `total`, group after group."""

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

    def spread(self, by_group: float | Mapping[str, float]) -> Tensor:
        """A vector, float64 [total], in which every coordinate has its group's value, or the one value of all."""
        values = by_group if isinstance(by_group, Mapping) else dict.fromkeys(self.groups, by_group)
        return torch.cat([torch.full((self.shapes[g].numel(),), values[g], dtype=torch.float64) for g in self.groups])

    def mask(self, coordinates: Iterable[tuple[str, int]]) -> Tensor:
        """A mask, bool [total], that is true at the given (group, flat index within the group)."""
        mask = torch.zeros(self.total, dtype=torch.bool)
        mask[[self.starts[group] + index for group, index in coordinates]] = True
        return mask


class Constraint(Protocol):
    """Constraint of a scene beyond a box for each group, such as that objects do not overlap. Zeros satisfy it."""

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

    def in_plan(self, plan: Plan) -> Plan:
        """Returns the plan with what the search leaves out."""
        ...


@dataclass(frozen=True)
class Limits:
    """Limits of a perturbation [total]: a box, the scene's constraint, and the distance of its image from the
    original.
    """

    layout: Layout
    low: Tensor
    """Smallest change of each coordinate [total]; -inf where there is no limit, 0 where it is fixed."""
    high: Tensor
    """Largest change of each coordinate [total], likewise."""
    fixed: Tensor
    """Coordinates that stay as they are, bool [total]: the constraint's, and those left out of the search."""
    epsilon: Mapping[str, float]
    """The request's ε of each group that has one; the box is within it."""
    truncation: float | None = None
    """U in [0,1], to which images are truncated; None: they are not."""
    backtrack: float | None = None
    """U in [0,1], to which perturbations are pulled back; None: they are not."""
    perceptibility: float | None = None
    """Largest p of an image, to which perturbations are pulled back; None: no limit."""
    constraint: Constraint | None = None
    """Constraint of the scene; None: there is none."""

    @classmethod
    def of(
        cls,
        renderer: Renderer,
        groups: Sequence[str],
        *,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        epsilon: Mapping[str, float] | None = None,
        constraint: Constraint | None = None,
        **others: float | None,
    ) -> "Limits":
        """The limits of the attacked groups of a renderer: its bounds of their values, the request's `bounds`, and
        `epsilon`, the largest change, each by group.

        Raises InvalidRequest("attack.bounds.<group>") if the request's bounds exclude a value of the scene itself, and
        that or InvalidRequest("attack.epsilon.<group>") if they go beyond what the renderer can draw.
        """
        start, physical, bounds, epsilon = renderer.initial(), renderer.bounds(), bounds or {}, epsilon or {}
        initial = {group: start[group] for group in groups}
        layout = Layout.of(initial)
        lows, highs = [], []
        for group, value in initial.items():
            low, high = (bound.to(value.dtype) - value for bound in physical[group])
            if group in bounds:
                _check_start(group, value, bounds[group])
                _check_reach(group, physical[group], bounds[group])
                low, high = low.clamp_min(bounds[group][0] - value), high.clamp_max(bounds[group][1] - value)
                # rounding, and the slack of the check, must not exclude the start itself
                low, high = low.clamp_max(0.0), high.clamp_min(0.0)
            if group in epsilon:
                _check_epsilon(group, value, physical[group], epsilon[group])
                low, high = low.clamp_min(-epsilon[group]), high.clamp_max(epsilon[group])
            lows.append(low.flatten())
            highs.append(high.flatten())
        low, high, free = torch.cat(lows), torch.cat(highs), layout.zeros(torch.bool)
        limits = cls(layout, low, high, free, epsilon, constraint=constraint, **others)
        masks = {} if constraint is None else constraint.fixed
        return limits.fixing(layout.flatten(layout.unflatten(free) | dict(masks)))

    def fixing(self, coordinates: Tensor) -> "Limits":
        """The same limits with further coordinates fixed, a mask, bool [total]."""
        low, high = self.low.masked_fill(coordinates, 0.0), self.high.masked_fill(coordinates, 0.0)
        return replace(self, low=low, high=high, fixed=self.fixed | coordinates)

    @property
    def backtracks(self) -> bool:
        """Whether perturbations are pulled back until their image is near the original."""
        return self.backtrack is not None or self.perceptibility is not None

    def clamp(self, deltas: Tensor) -> Tensor:
        """Perturbations [..., total], clamped to the box."""
        return deltas.clamp(self.low, self.high)

    def moved(self, delta: Tensor, changes: Tensor) -> Tensor:
        """The perturbation `delta` [total] moved by each of `changes`, float64 [..., total], and clamped."""
        return self.clamp((delta.double() + changes).to(delta.dtype))

    def project(self, deltas: Tensor) -> Tensor:
        """Perturbations [B, total] projected to the constraint."""
        if self.constraint is None:
            return deltas
        allowed = [self.constraint.project(self.layout.unflatten(delta.detach())) for delta in deltas]
        return torch.stack([self.layout.flatten(values) for values in allowed])

    def holds(self, delta: Tensor) -> bool:
        """Whether the constraint allows a perturbation [total]."""
        return self.constraint is None or self.constraint.holds(self.layout.unflatten(delta))

    def allowed(self, deltas: Tensor, instead: Tensor) -> Tensor:
        """Perturbations [B, total], with `instead` [total] in place of those that the constraint does not allow."""
        if self.constraint is None:
            return deltas
        return torch.stack([delta if self.holds(delta) else instead.to(delta.dtype) for delta in deltas])

    def truncate(self, images: Tensor, original: Tensor) -> tuple[Tensor, Tensor]:
        """Images truncated to U around the original, and the mask of the truncated pixels; see `truncate`."""
        return truncate(images, original, self.truncation)

    def reached(self, image: Tensor, original: Tensor) -> float:
        """The part of the limits of backtracking that an image [1, H, W, 3] takes: of `backtrack` its largest change of
        a value, of `perceptibility` its p, whichever is more; both less the margin that backtracking keeps.
        """
        change, parts = image - original, [0.0]
        if self.backtrack is not None:
            parts.append(float(change.abs().max()) / (self.backtrack - BACKTRACK_MARGIN + ROUNDING))
        if self.perceptibility is not None:
            p = float(change.double().square().sum(-1).mean().sqrt())
            parts.append(p / ((1 - P_MARGIN) * self.perceptibility))
        return max(parts)


def _check_start(group: str, value: Tensor, bounds: tuple[float, float]) -> None:
    low, high = bounds
    beyond = torch.maximum(low - value, value - high)
    if bool((beyond > BOUND_SLACK * (1 + value.abs())).any()):
        outside = float(value.flatten()[beyond.argmax()])
        raise InvalidRequest(
            f"attack.bounds.{group}",
            f"they exclude the start: the scene itself has a value of {outside:g}, not within {low:g} to {high:g}",
        )


def _check_reach(group: str, physical: tuple[Tensor, Tensor], bounds: tuple[float, float]) -> None:
    """Bounds that all values would stop short of are another unit, or a misunderstanding."""
    least, most = float(physical[0].min()), float(physical[1].max())
    if bounds[0] < least - BOUND_SLACK * (1 + abs(least)) or bounds[1] > most + BOUND_SLACK * (1 + abs(most)):
        raise InvalidRequest(
            f"attack.bounds.{group}",
            f"{bounds[0]:g} to {bounds[1]:g} goes beyond what can be drawn, {least:g} to {most:g}; stay within it",
        )


def _check_epsilon(group: str, value: Tensor, physical: tuple[Tensor, Tensor], epsilon: float) -> None:
    """The same of ε where values are changes, which are 0 in every scene; others have more or less room by scene."""
    most = float(torch.maximum(physical[0].abs(), physical[1].abs()).max())
    if not bool(value.any()) and epsilon > most * (1 + BOUND_SLACK):
        raise InvalidRequest(
            f"attack.epsilon.{group}",
            f"{epsilon:g} goes beyond what can be drawn, a change of {most:g}; give at most that",
        )


def at_epsilon(perturbation: Mapping[str, Tensor], epsilon: Mapping[str, float]) -> dict[str, Tensor]:
    """Which values of each group that has an ε are at it, within `EDGE`: bool, of the shape of the group."""
    return {group: perturbation[group].abs() >= (1 - EDGE) * limit for group, limit in epsilon.items()}


def truncate(images: Tensor, original: Tensor, limit: float | None) -> tuple[Tensor, Tensor]:
    """Clamps RGB values to within `limit` of the original. Returns the images and the mask of changed pixels.

    `images` and `original` are [1, H, W, 3] in [0,1]; `limit` is in [0,1], or None for no limit; the mask is bool
    [H, W]. A clamped value passes no gradient (paper, section 3.3).
    """
    nowhere = torch.zeros(images.shape[1:3], dtype=torch.bool, device=images.device)
    if limit is None:
        return images, nowhere
    change = images.detach() - original
    low, high = torch.aminmax(change)
    if max(-float(low), float(high)) <= limit + ROUNDING:
        return images, nowhere
    beyond = (change.abs_().amax(dim=-1) > limit + ROUNDING)[0]
    return images.clamp(original - limit, original + limit), beyond


def pulled_back(reach: Callable[[Tensor], float], deltas: Tensor) -> Tensor:
    """Scales each perturbation of `deltas` [B, total] back until its reach is 1 at most, and close to it.

    `reach` maps a perturbation [total] to the part of the limit that its image takes: 0 for the zero vector, above 1
    beyond the limit. Perturbations within it are returned as they are.
    """
    return torch.stack([_scale(reach, delta) * delta for delta in deltas])


def _scale(reach: Callable[[Tensor], float], delta: Tensor) -> float:
    """A factor in [0, 1] at which the reach is between 1 − `SLACK` and 1; after `MAX_TRIES` the largest within.

    Changes of colour grow with the factor, those of moving silhouettes with its root. So the reach is taken as a power
    of the factor, whose exponent is that between the last two factors.
    """
    low, high, at_high, power = 0.0, 1.0, reach(delta), 1.0
    if at_high <= 1:
        return 1.0
    for _ in range(MAX_TRIES):
        tried = max(low + SMALLEST_STEP * (high - low), high * (AIM / at_high) ** (1 / power))
        part = reach(tried * delta)
        if 0 < part < at_high:
            power = min(max(log(at_high / part) / log(high / tried), LEAST_POWER), MOST_POWER)
        if part > 1:
            high, at_high = tried, part
        else:
            low = tried
            if part >= 1 - SLACK or part == 0:
                break
    return low
