"""SPSA (Spall 1992; Uesato et al. 2018): the gradient from differences along random directions, moved by Adam."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from services.attacks.limits import Limit
from services.attacks.spec import AttackSettings, Rate, register
from services.attacks.suggested import suggested_limits

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters

HALF_STEP, RATE = 1 / 16, 1 / 16
"""The default half-step and learning rate, in ε."""
BETAS = (0.9, 0.999)
SMALLEST_DENOMINATOR = 1e-12


class Spsa(AttackSettings):
    """Simultaneous perturbation (Spall 1992): all parameters move at once along random directions and back, and the
    mean of the differences, moved by Adam, estimates the gradient (Uesato et al. 2018). It needs scores only.
    """

    method: Literal["spsa"] = "spsa"
    pairs: Annotated[int, Field(ge=1, le=4096)] = Field(
        16, description="random directions of a step, each evaluated forwards and backwards: 2 queries"
    )
    directions: Literal["signs", "gaussian"] = Field(
        "signs",
        description="`signs`: each coordinate moves by its half-step or back (SPSA); `gaussian`: by a normal random "
        "multiple of it (antithetic NES)",
    )
    delta: dict[str, Limit] = Field(
        default_factory=dict,
        description="half-step of the difference of each group, in the group's units; default: 1/16 of its `epsilon`",
    )
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="Adam's learning rate of each group, in the group's units; default: 1/16 of its `epsilon`",
    )

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the limits that the renderer suggests for its groups, and what follows from them."""
        data = suggested_limits(data)
        limits = data.get("epsilon")
        if not isinstance(limits, dict):
            return data
        for field, share in (("delta", HALF_STEP), ("learning_rate", RATE)):
            given = data.get(field) or {}
            if isinstance(given, dict):
                values = {group: share * limit for group, limit in limits.items() if isinstance(limit, int | float)}
                data = data | {field: values | given}
        return data

    @model_validator(mode="after")
    def _a_value_for_each_group(self) -> Self:
        self.check_groups("epsilon", self.epsilon)
        self.check_groups("delta", self.delta)
        self.check_groups("learning_rate", self.learning_rate)
        return self


@register(Spsa)
class SpsaMethod:
    """Each step averages the estimates of `pairs` directions and moves all coordinates by Adam."""

    needs_gradient = False

    def __init__(self, settings: Spsa, problem: AttackProblem) -> None:
        self.settings = settings
        self.layout = problem.layout
        self.delta = self.layout.flatten(problem.beginning)
        self.half_steps = self.layout.spread(settings.delta)
        self.rates = self.layout.spread(settings.learning_rate)
        self.first = self.layout.zeros().double()
        self.second = self.layout.zeros().double()

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group."""
        return self.layout.unflatten(self.delta)

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """SPSA measures no settings."""
        return {}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Takes one step. Returns the number of directions along which the objective does not change."""
        from services.attacks.differences import clamped

        at = self.layout.flatten(view.perturbation)
        kind = self.settings.directions
        directions = draw_directions(kind, self.settings.pairs, self.layout.total, problem.seed, step)
        estimates = estimate(problem, at, directions, self.half_steps, gaussian=kind == "gaussian")
        gradient = estimates.mean(dim=0)
        self.first = BETAS[0] * self.first + (1 - BETAS[0]) * gradient
        self.second = BETAS[1] * self.second + (1 - BETAS[1]) * gradient.square()
        first, second = self.first / (1 - BETAS[0] ** (step + 1)), self.second / (1 - BETAS[1] ** (step + 1))
        change = self.rates * first / (second.sqrt() + SMALLEST_DENOMINATOR)
        self.delta = clamped(problem, (at.double() - change).to(at.dtype)[None])[0]
        return int((estimates == 0).all(dim=1).sum())

    def state(self) -> dict[str, Tensor]:
        """The perturbation and Adam's moments."""
        return {"delta": self.delta, "first": self.first, "second": self.second}

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.delta, self.first, self.second = state["delta"], state["first"], state["second"]


def draw_directions(kind: str, count: int, total: int, seed: int, step: int) -> Tensor:
    """`count` random directions of a step, float64 [count, total]: ±1 for the kind "signs", else standard normal."""
    import torch

    from services.attacks.seeds import generator

    random = generator(seed, "spsa", step)
    if kind == "signs":
        return 2.0 * torch.randint(0, 2, (count, total), generator=random).double() - 1.0
    return torch.randn(count, total, generator=random, dtype=torch.float64)


def estimate(problem: AttackProblem, at: Tensor, directions: Tensor, half_steps: Tensor, *, gaussian: bool) -> Tensor:
    """An estimate of the objective's gradient from each direction alone, float64 [n, total].

    `at` [total] is the perturbation; both sides at ± half_steps [total] · directions [n, total] are clamped to the
    bounds. With signs an estimate is the change over the distance of each coordinate, with Gaussian directions the
    change times the direction over twice the half-step. Both are unbiased where the objective is quadratic; within
    bounds of one side only the former is.
    """
    import torch

    from services.attacks.differences import clamped, evaluate

    moves = directions * half_steps
    forwards, backwards = (clamped(problem, (at.double() + sign * moves).to(at.dtype)) for sign in (1.0, -1.0))
    objectives = evaluate(problem, torch.stack([forwards, backwards], dim=1).flatten(0, 1)).reshape(-1, 2)
    change = (objectives[:, 0] - objectives[:, 1])[:, None]
    distance = (forwards - backwards).double()
    if gaussian:
        return change * distance / (2 * half_steps).square()
    return torch.where(distance == 0, 0.0, change / distance.where(distance != 0, torch.ones_like(distance)))
