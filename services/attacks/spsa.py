"""SPSA (Spall 1992; Uesato et al. 2018): the gradient from differences along random directions, moved by Adam."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from services.attacks.attack import DifferencesWithinLimits, register

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters


class Spsa(DifferencesWithinLimits):
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


@register(Spsa)
class SpsaMethod:
    """Each step averages the estimates of `pairs` directions and moves all coordinates by Adam."""

    needs_gradient = False

    def __init__(self, settings: Spsa, problem: AttackProblem) -> None:
        from services.attacks.adam import Adam

        self.settings = settings
        self.layout = problem.layout
        self.delta = self.layout.flatten(problem.beginning)
        self.half_steps = self.layout.spread(settings.delta)
        self.adam = Adam(self.layout.spread(settings.learning_rate))

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group."""
        return self.layout.unflatten(self.delta)

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """SPSA measures no settings."""
        return {}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Takes one step. Returns the number of directions along which the objective does not change."""
        from services.attacks.differences import moved

        at = self.layout.flatten(view.perturbation)
        kind = self.settings.directions
        directions = draw_directions(kind, self.settings.pairs, self.layout.total, problem.seed, step)
        estimates = estimate(problem, at, directions, self.half_steps, gaussian=kind == "gaussian")
        change = self.adam.change(estimates.mean(dim=0), step)
        self.delta = moved(problem, at, change[None])[0]
        return int((estimates == 0).all(dim=1).sum())

    def state(self) -> dict[str, Tensor]:
        """The perturbation and Adam's moments."""
        return {"delta": self.delta} | self.adam.state()

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.delta = state["delta"]
        self.adam.load(state)


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

    from services.attacks.differences import evaluate, moved

    moves = directions * half_steps
    forwards, backwards = (moved(problem, at, sign * moves) for sign in (1.0, -1.0))
    objectives = evaluate(problem, torch.stack([forwards, backwards], dim=1).flatten(0, 1)).reshape(-1, 2)
    change = (objectives[:, 0] - objectives[:, 1])[:, None]
    distance = (forwards - backwards).double()
    if gaussian:
        return change * distance / (2 * half_steps).square()
    return torch.where(distance == 0, 0.0, change / distance.where(distance != 0, torch.ones_like(distance)))
