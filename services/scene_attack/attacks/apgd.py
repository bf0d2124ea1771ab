"""APGD (Croce & Hein 2020): projected gradient descent with momentum that halves its step where it stops improving."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scene_attack.attacks.attack import Attack, register, suggested_limits
from scene_attack.attacks.request import LOSS_DESCRIPTION, Loss
from scene_attack.attacks.square import groups_without_pixels

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

FIRST_STEP = 2.0
"""First step size, in ε."""
MOMENTUM = 0.75
"""α: share of the projected step in the update; the rest is the update before."""
ENOUGH_RISES = 0.75
"""ρ: the step is halved at a checkpoint unless more than this share of the steps before it improved the objective."""
FIRST_PERIOD, SHORTER_BY, SHORTEST_PERIOD = 0.22, 0.03, 0.06
"""Shares of `steps`: the first checkpoint's period, the decrease of each next period, and the shortest period."""


@register
class APGD(Attack):
    """Auto-PGD (Croce & Hein 2020): sign steps within ε with momentum; at checkpoints the step is halved and the best
    point taken up again if too few steps improved the objective. It has no step size to choose: steps are measured in
    ε, which each group therefore has, whatever else limits the perturbation.
    """

    method: Literal["apgd"] = "apgd"
    needs_gradient: ClassVar[bool] = True
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=100, description="largest number of steps, over which the checkpoints are spread"
    )
    loss: Loss = Field(default="log-odds", description=LOSS_DESCRIPTION)
    masking_queries: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=0,
        description="after an attack that held, `square` tries with at most this number of queries, and the result's "
        "settings say under `masking` whether it succeeded: then the gradient is masked; 0: no such check",
    )

    @property
    def objective(self) -> Loss:
        """The loss whose gradient the loop computes."""
        return self.loss

    @property
    def masking_check(self) -> int:
        """Queries of the check for masked gradients."""
        return self.masking_queries

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the limits that the renderer suggests for its groups."""
        return suggested_limits(data)

    @model_validator(mode="after")
    def _a_limit_for_each_group(self) -> Self:
        self.check_groups("epsilon", self.epsilon)
        for group in groups_without_pixels(self) if self.masking_queries else ():
            raise ValueError(f"masking_queries: {group!r} is no image, which square needs; leave this out")
        return self

    def init(self, problem: AttackProblem) -> State:
        """No point has an objective yet. The first checkpoint compares with none, so the one before it counts as one
        that halved the step.
        """
        delta, numbers = problem.start, problem.start.double()
        period = max(int(FIRST_PERIOD * self.steps), 1)
        return {
            "delta": delta,
            "before": delta,
            "best": delta,
            "best_direction": delta,
            "objectives": numbers.new_full((3,), inf),
            "step_size": numbers.new_tensor(FIRST_STEP),
            "schedule": numbers.new_tensor([period, 0, 0, True]).long(),
        }

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """z = P(x − η·ε·sign ∇);  x ← P(x + α·(z − x) + (1 − α)·(x − x before)), with the same η for all groups.

        P projects onto the box, which ε is part of. x is the point that was evaluated, or after a halving the best one.
        """
        assert evaluation.gradient is not None
        clamp = problem.limits.clamp
        checked = self._checked(state, evaluation, -evaluation.gradient.sign())
        at, direction = checked.pop("at"), checked.pop("direction")
        share = 1.0 if evaluation.step == 0 else MOMENTUM
        radius = problem.layout.spread(self.epsilon).to(at.dtype)
        stepped = clamp(at + float(checked["step_size"]) * radius * direction)
        delta = clamp(at + share * (stepped - at) + (1 - share) * (at - state["before"]))
        return checked | {"delta": delta, "before": at}

    def _checked(self, state: State, evaluation: Evaluation, direction: Tensor) -> State:
        """Records the objective, and halves the step at a checkpoint if too few steps improved it.

        Returns the best point, its direction of descent and the schedule, and the point `at` to go on from with its
        `direction`. `objectives` are of the last point, of the best, and of the best at the last checkpoint. The
        schedule is the number of steps between checkpoints, those since the last, how many of them lowered the
        objective, and whether the last checkpoint halved the step.
        """
        at, objective, step_size = evaluation.delta, evaluation.objective, float(state["step_size"])
        best, best_direction = state["best"], state["best_direction"]
        last, least, least_at_checkpoint = state["objectives"].tolist()
        period, since, improved, halved = state["schedule"].tolist()
        if objective < least:
            least, best, best_direction = objective, at, direction
        if evaluation.step == 0:
            least_at_checkpoint = least
        else:
            since += 1
            improved += objective < last
        if since == period:
            stuck = not halved and least_at_checkpoint <= least
            halved = stuck or improved <= ENOUGH_RISES * period
            least_at_checkpoint = least
            since, improved = 0, 0
            shortest = max(int(SHORTEST_PERIOD * self.steps), 1)
            period = max(period - max(int(SHORTER_BY * self.steps), 1), shortest)
            if halved:
                step_size /= 2
                at, direction = best, best_direction
        return {
            "at": at,
            "direction": direction,
            "best": best,
            "best_direction": best_direction,
            "objectives": state["objectives"].new_tensor([objective, least, least_at_checkpoint]),
            "step_size": state["step_size"].new_tensor(step_size),
            "schedule": state["schedule"].new_tensor([period, since, improved, halved]),
        }
