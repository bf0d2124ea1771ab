"""A job's coordinates that are left out of the search because they hardly change the answer, measured at its start."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from services.attacks.leave_out import Effects, measure, without
from services.attacks.limits import fixed
from services.attacks.problem import AttackProblem
from services.rendering.plan import Item, Plan


@dataclass(frozen=True)
class LeavingOut:
    """What was measured of a problem, with the names of its coordinates."""

    change: Mapping[str, float]
    effects: Effects
    names: tuple[str, ...]
    groups: tuple[str, ...]
    """The group of each coordinate."""
    stays: tuple[bool, ...]
    """Whether each coordinate was fixed before, so that nothing was measured of it."""

    @property
    def settings(self) -> dict[str, object]:
        """What was measured, as JSON: the advantage, the effect of each coordinate, and what is left out."""
        effects = self.effects
        alone = zip(self.names, self.groups, self.stays, effects.alone.tolist(), strict=True)
        return {
            "advantage": effects.advantage,
            "effects": {name: effect for name, group, stays, effect in alone if group in self.change and not stays},
            "left_out": self._left_out(),
            "together": effects.together,
        }

    def in_plan(self, plan: Plan) -> Plan:
        """Returns the plan with a line for each group that was measured."""
        items = []
        for group, change in self.change.items():
            left = self._left_out(group)
            of = sum(own == group and not stays for own, stays in zip(self.groups, self.stays, strict=True))
            items.append(
                Item(
                    part=group,
                    what="coordinates that reach the answer",
                    kept=of - len(left),
                    of=of,
                    why=f"each was moved by ±{change:g}; those left out change the answer's advantage of "
                    f"{self.effects.advantage:.3g} by {self.effects.together:.2g} together: "
                    f"{', '.join(left) or 'none is left out'}",
                )
            )
        return plan.model_copy(update={"items": (*plan.items, *items)})

    def _left_out(self, group: str | None = None) -> list[str]:
        rows = zip(self.names, self.groups, self.effects.left_out.tolist(), strict=True)
        return [name for name, own, left in rows if left and group in (None, own)]


def leaving_out(
    problem: AttackProblem, change: Mapping[str, float], report: Callable[[int, int], None]
) -> tuple[AttackProblem, LeavingOut | None]:
    """Measures the coordinates of the groups in `change`; returns the problem without those that hardly count.

    The problem itself and None if there is nothing to measure. `report` is told the number of images done, and of all.
    """
    if not change:
        return problem, None
    effects = measure(problem, change, report)
    layout = problem.layout
    names = tuple(
        name
        for group in layout.groups
        for name in problem.renderer.names(group) or [group] * layout.shapes[group].numel()
    )
    groups = tuple(group for group in layout.groups for _ in range(layout.shapes[group].numel()))
    stays = tuple(fixed(problem.constraint, layout).tolist())
    found = LeavingOut(change, effects, names, groups, stays)
    return replace(problem, constraint=without(problem, effects.left_out)), found
