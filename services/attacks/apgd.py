"""APGD (Croce & Hein 2020): projected gradient descent with momentum that halves its step where it stops improving."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from services.attacks.attack import AttackSettings, register, suggested_limits
from services.attacks.losses import DESCRIPTION, Loss
from services.attacks.square import groups_without_pixels

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters

FIRST_STEP = 2.0
"""First step size, in ε."""
MOMENTUM = 0.75
"""α: share of the projected step in the update; the rest is the update before."""
ENOUGH_RISES = 0.75
"""ρ: the step is halved at a checkpoint unless more than this share of the steps before it improved the objective."""
FIRST_PERIOD, SHORTER_BY, SHORTEST_PERIOD = 0.22, 0.03, 0.06
"""Number of steps up to the first checkpoint, by which each next period is shorter, and of the shortest, in `steps`."""


class Apgd(AttackSettings):
    """Auto-PGD (Croce & Hein 2020): sign steps within ε with momentum; at checkpoints the step is halved and the best
    point taken up again if too few steps improved the objective. It has no step size to choose: steps are measured in
    ε, which each group therefore has, whatever else limits the perturbation.
    """

    method: Literal["apgd"] = "apgd"
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(
        100, description="largest number of steps, over which the checkpoints are spread"
    )
    loss: Loss = Field("log-odds", description=DESCRIPTION)
    masking_queries: Annotated[int, Field(ge=0, le=100_000)] = Field(
        0,
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


@register(Apgd)
class ApgdMethod:
    """z = P(x − η·ε·sign ∇);  x ← P(x + α·(z − x) + (1 − α)·(x − x before)), with the same η for all groups.

    P projects onto the bounds, which ε is part of. Works on all groups as one vector.
    """

    needs_gradient = True

    def __init__(self, settings: Apgd, problem: AttackProblem) -> None:
        import torch

        self.layout = problem.layout
        self.delta = self.layout.flatten(problem.beginning)
        self.before = self.delta
        self.best = self.delta
        self.best_direction = self.delta
        self.radius = self.layout.spread(settings.epsilon).to(self.delta.dtype)
        self.shorter_by = max(int(SHORTER_BY * settings.steps), 1)
        self.shortest = max(int(SHORTEST_PERIOD * settings.steps), 1)
        self.objectives = torch.full((3,), torch.inf, dtype=torch.float64)
        """Of the last point, of the best, and of the best at the last checkpoint."""
        self.step_size = FIRST_STEP
        self.period = max(int(FIRST_PERIOD * settings.steps), 1)
        self.since = 0
        """Steps since the last checkpoint."""
        self.improved = 0
        """How many of them lowered the objective."""
        self.halved = True
        """Whether the last checkpoint halved the step. The first checkpoint compares with none."""

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group."""
        return self.layout.unflatten(self.delta)

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """APGD measures no settings."""
        return {}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Takes one step from the evaluated point, or from the best one after a halving. Returns the number of groups
        whose gradient is zero throughout.
        """
        from services.attacks.differences import clamped

        at = self.layout.flatten(view.perturbation).detach()
        direction = -self.layout.flatten(view.gradients).sign()
        at, direction = self._judge(at, direction, view.objective, step)
        share = 1.0 if step == 0 else MOMENTUM
        stepped = clamped(problem, (at + self.step_size * self.radius * direction)[None])[0]
        moved = at + share * (stepped - at) + (1 - share) * (at - self.before)
        self.before, self.delta = at, clamped(problem, moved[None])[0]
        return view.n_flat

    def _judge(self, at: Tensor, direction: Tensor, objective: float, step: int) -> tuple[Tensor, Tensor]:
        """Records the objective of `at`; returns the point to go on from and its direction of descent."""
        last, best, best_at_checkpoint = self.objectives.tolist()
        if objective < best:
            best, self.best, self.best_direction = objective, at, direction
        if step == 0:
            best_at_checkpoint = best
        else:
            self.since += 1
            self.improved += objective < last
        if self.since == self.period:
            stuck = not self.halved and best_at_checkpoint <= best
            self.halved = stuck or self.improved <= ENOUGH_RISES * self.period
            best_at_checkpoint = best
            self.since, self.improved = 0, 0
            self.period = max(self.period - self.shorter_by, self.shortest)
            if self.halved:
                self.step_size /= 2
                at, direction = self.best, self.best_direction
        self.objectives = self.objectives.new_tensor([objective, best, best_at_checkpoint])
        return at, direction

    def state(self) -> dict[str, Tensor]:
        """The current, the former and the best point, the best point's direction, objectives, and the schedule."""
        counts = [self.period, self.since, self.improved, int(self.halved)]
        return {
            "delta": self.delta,
            "before": self.before,
            "best": self.best,
            "best_direction": self.best_direction,
            "objectives": self.objectives,
            "step_size": self.objectives.new_tensor(self.step_size),
            "schedule": self.objectives.new_tensor(counts).long(),
        }

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.delta, self.before, self.best = state["delta"], state["before"], state["best"]
        self.best_direction, self.objectives = state["best_direction"], state["objectives"]
        self.step_size = float(state["step_size"])
        self.period, self.since, self.improved, halved = state["schedule"].tolist()
        self.halved = bool(halved)
