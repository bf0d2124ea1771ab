"""Leaves coordinates out of a search that hardly change the answer, after measuring that they do not.

Each coordinate is moved alone, up and down, and the change of the answer's advantage is its effect. Left out are the
coordinates of the smallest effects whose sum is at most `SHARE` of the advantage that the attack has to overcome. Then
all of them are moved together, at random signs; as long as that changes the advantage by more, half of them are taken
back.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from services.attacks.differences import clamped, per_batch
from services.attacks.limits import Constraint, fixed, projected
from services.attacks.problem import AttackProblem
from services.attacks.seeds import generator
from services.rendering.protocol import Parameters

SHARE = 0.01
"""Largest change of the advantage, as a share of it, that coordinates which are left out may make together."""
DRAWS = 8
"""Random signs at which they are moved together."""


@dataclass(frozen=True)
class LeftOut:
    """A constraint that also fixes the coordinates that are left out; implements `Constraint`."""

    inner: Constraint | None
    masks: Mapping[str, Tensor]
    """The coordinates left out, bool of the shape of each attacked group."""

    @property
    def fixed(self) -> Mapping[str, Tensor]:
        """The coordinates that either fixes."""
        own = {} if self.inner is None else self.inner.fixed
        return {group: mask | own[group] if group in own else mask for group, mask in self.masks.items()}

    def holds(self, perturbation: Parameters) -> bool:
        """Whether the inner constraint allows a perturbation."""
        return self.inner is None or self.inner.holds(perturbation)

    def project(self, perturbation: Parameters) -> Parameters:
        """Projects to the inner constraint."""
        return perturbation if self.inner is None else self.inner.project(perturbation)


@dataclass(frozen=True)
class Effects:
    """What was measured: the advantage at the start, the effect of each coordinate alone, float64 [total], a mask of
    those left out, bool [total], and the largest change of the advantage by all of these together.
    """

    advantage: float
    alone: Tensor
    left_out: Tensor
    together: float


@torch.no_grad()
def measure(
    problem: AttackProblem, change: Mapping[str, float], report: Callable[[int, int], None] = lambda _, __: None
) -> Effects:
    """Measures the coordinates of the groups in `change`, moved by this much in the group's units.

    Two images and queries for each coordinate that the constraint does not fix, and DRAWS or more in addition.
    `report` is told the number of the former that are done, and of all.
    """
    layout = problem.layout
    moves = layout.spread({group: change.get(group, 0.0) for group in layout.groups})
    free = (moves > 0) & ~fixed(problem.constraint, layout)
    candidates = free.nonzero()[:, 0]
    nothing = layout.flatten(problem.nothing())
    sides = torch.zeros(2 * len(candidates), layout.total, dtype=torch.float64)
    rows = torch.arange(len(candidates))
    sides[2 * rows, candidates] = moves[candidates]
    sides[2 * rows + 1, candidates] = -moves[candidates]
    [start] = _advantages(problem, nothing[None])
    changes = (_advantages(problem, _within(problem, sides.to(nothing.dtype)), report) - start).abs()
    alone = layout.zeros().double()
    alone[candidates] = changes.reshape(-1, 2).amax(dim=1)
    limit = SHARE * max(0.0, float(start))
    order = candidates[alone[candidates].argsort(stable=True)]
    chosen = order[alone[order].cumsum(0) <= limit][: max(0, len(order) - 1)]  # something must be left to search
    signs = 2.0 * torch.randint(0, 2, (DRAWS, layout.total), generator=generator(problem.seed, "leave out")) - 1
    together = 0.0
    while len(chosen):
        mask = torch.zeros(layout.total, dtype=torch.bool)
        mask[chosen] = True
        moved = _within(problem, (signs * moves * mask).to(nothing.dtype))
        together = float((_advantages(problem, moved) - start).abs().max())
        if together <= limit:
            return Effects(float(start), alone, mask, together)
        chosen = chosen[: len(chosen) // 2]
    return Effects(float(start), alone, torch.zeros(layout.total, dtype=torch.bool), 0.0)


def without(problem: AttackProblem, left_out: Tensor) -> LeftOut:
    """Returns the problem's constraint with the coordinates of a mask [total] fixed."""
    return LeftOut(problem.constraint, problem.layout.unflatten(left_out))


def _within(problem: AttackProblem, vectors: Tensor) -> Tensor:
    """Moves [B, total] from the scene as it is, clamped and projected to the constraint."""
    return projected(problem.constraint, problem.layout, clamped(problem, vectors))


def _advantages(
    problem: AttackProblem, vectors: Tensor, report: Callable[[int, int], None] = lambda _, __: None
) -> Tensor:
    """The advantage of the present answer at perturbations [B, total], float64 [B] on the CPU."""
    start = problem.layout.flatten(problem.initial)
    found = []
    for chunk in torch.split(vectors, per_batch(problem)):
        images = problem.render(problem.layout.unflatten(start + chunk))
        found.append(problem.goal.advantage(problem.logits(images)).double().cpu())
        report(sum(map(len, found)), len(vectors))
    return torch.cat(found)
