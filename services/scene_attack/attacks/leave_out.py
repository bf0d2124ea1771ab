"""Leaves coordinates out of a search that hardly change the answer, after measuring that they do not.

Each coordinate is moved alone, up and down, and the change of the answer's advantage is its effect. Left out are the
coordinates of the smallest effects whose sum is at most `SHARE` of the advantage that the attack has to overcome. Then
all of them are moved together, at random signs; as long as that changes the advantage by more, half of them are taken
back.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from scene_attack.attacks.problem import AttackProblem
from scene_attack.rendering.plan import Item, Plan

SHARE = 0.01
"""Largest change of the advantage, as a share of it, that coordinates which are left out may make together."""
DRAWS = 8
"""Random signs at which they are moved together."""


@dataclass(frozen=True)
class LeftOut:
    """Measured effects of a problem's coordinates, and which of them are left out."""

    problem: AttackProblem
    """The problem of which they were measured; what its constraint fixes was not measured."""
    change: Mapping[str, float]
    """Change by which each coordinate was moved, by group."""
    advantage: float
    """The advantage at the start."""
    alone: Tensor
    """The effect of each coordinate alone, float64 [total]."""
    left_out: Tensor
    """Coordinates that are left out, bool [total]."""
    together: float
    """The largest change of the advantage by all of these together."""

    @property
    def without(self) -> AttackProblem:
        """The problem without the coordinates that are left out."""
        return replace(self.problem, limits=self.problem.limits.fixing(self.left_out))

    @property
    def settings(self) -> dict[str, object]:
        """Measurements, as JSON: the advantage, the effect of each coordinate, and what is left out."""
        names, measured = self._names(), self._measured()
        return {
            "advantage": self.advantage,
            "effects": {names[k]: float(self.alone[k]) for k in measured},
            "left_out": [names[k] for k in measured if self.left_out[k]],
            "together": self.together,
        }

    def in_plan(self, plan: Plan) -> Plan:
        """Returns the plan with a line for each group that was measured."""
        names, items = self._names(), []
        for group, change in self.change.items():
            measured = self._measured(group)
            left = [names[k] for k in measured if self.left_out[k]]
            items.append(
                Item(
                    part=group,
                    what="coordinates that reach the answer",
                    kept=len(measured) - len(left),
                    of=len(measured),
                    why=f"each was moved by ±{change:g}; those left out change the answer's advantage of "
                    f"{self.advantage:.3g} by {self.together:.2g} together: "
                    f"{', '.join(left) or 'none is left out'}",
                )
            )
        return plan.model_copy(update={"items": (*plan.items, *items)})

    def _names(self) -> list[str]:
        """The name of each coordinate."""
        layout, names_of = self.problem.layout, self.problem.renderer.names
        return [name for group in layout.groups for name in names_of(group) or [group] * layout.shapes[group].numel()]

    def _measured(self, group: str | None = None) -> list[int]:
        """The coordinates that were measured, of one group or of all."""
        layout, fixed = self.problem.layout, self.problem.limits.fixed
        groups = [layout.group_of(k) for k in range(layout.total)]
        return [k for k, own in enumerate(groups) if own in self.change and group in (None, own) and not fixed[k]]


@torch.no_grad()
def leave_out(
    problem: AttackProblem, change: Mapping[str, float], report: Callable[[int, int], None] = lambda _, __: None
) -> LeftOut:
    """Measures the coordinates of the groups in `change`, moved by this much in the group's units.

    Two images and queries for each coordinate that the constraint does not fix, and DRAWS or more in addition.
    `report` is told the number of the former that are done, and of all.
    """
    layout, nothing = problem.layout, problem.nothing
    moves = layout.spread({group: change.get(group, 0.0) for group in layout.groups})
    candidates = ((moves > 0) & ~problem.limits.fixed).nonzero()[:, 0]
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
    signs = 2.0 * torch.randint(0, 2, (DRAWS, layout.total), generator=problem.generator("leave out")) - 1
    while len(chosen):
        mask = torch.zeros(layout.total, dtype=torch.bool)
        mask[chosen] = True
        moved = _within(problem, (signs * moves * mask).to(nothing.dtype))
        together = float((_advantages(problem, moved) - start).abs().max())
        if together <= limit:
            return LeftOut(problem, change, float(start), alone, mask, together)
        chosen = chosen[: len(chosen) // 2]
    return LeftOut(problem, change, float(start), alone, torch.zeros(layout.total, dtype=torch.bool), 0.0)


def _within(problem: AttackProblem, deltas: Tensor) -> Tensor:
    """Moves [B, total] from the scene as it is, clamped and projected to the constraint."""
    return problem.limits.project(problem.limits.clamp(deltas))


def _advantages(
    problem: AttackProblem, deltas: Tensor, report: Callable[[int, int], None] = lambda _, __: None
) -> Tensor:
    """The advantage of the present answer at perturbations [B, total], float64 [B] on the CPU."""
    advantages: list[Tensor] = []
    for chunk in torch.split(deltas, problem.per_batch):
        advantages.append(problem.advantages(problem.render(chunk)).cpu())
        report(sum(map(len, advantages)), len(deltas))
    return torch.cat(advantages)
