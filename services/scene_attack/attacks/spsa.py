"""SPSA (Spall 1992; Uesato et al. 2018): the gradient from differences along random directions, moved by Adam."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from scene_attack.attacks.attack import DifferencesWithinLimits, register

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

BETAS = (0.9, 0.999)
"""Adam's decay rates of both moments."""
SMALLEST_DENOMINATOR = 1e-12


@register
class SPSA(DifferencesWithinLimits):
    """Simultaneous perturbation (Spall 1992): all parameters move at once along random directions and back, and the
    mean of the differences, moved by Adam, estimates the gradient (Uesato et al. 2018). It needs scores only.
    """

    method: Literal["spsa"] = "spsa"
    needs_gradient: ClassVar[bool] = False
    pairs: Annotated[int, Field(ge=1, le=4096)] = Field(
        default=16, description="random directions of a step, each evaluated forwards and backwards: 2 queries"
    )
    directions: Literal["signs", "gaussian"] = Field(
        default="signs",
        description="`signs`: each coordinate moves by its half-step or back (SPSA); `gaussian`: by a normal random "
        "multiple of it (antithetic NES)",
    )

    def init(self, problem: AttackProblem) -> State:
        """Adam's moments are zero."""
        zeros = problem.start.new_zeros(problem.layout.total).double()
        return {"delta": problem.start, "first": zeros, "second": zeros}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """Averages the estimates of `pairs` directions and moves all coordinates by Adam."""
        at, step = evaluation.delta, evaluation.step
        half_steps = problem.layout.spread(self.delta)
        directions = draw_directions(self.directions, self.pairs, problem.layout.total, problem.seed, step)
        gaussian = self.directions == "gaussian"
        estimates = estimate(problem, at, directions, half_steps, gaussian=gaussian, step=step)
        return {
            **moved_by_adam(self, problem, state, at, estimates.mean(dim=0), step),
            "below_noise": (estimates == 0).all(dim=1).sum(),
        }


def moved_by_adam(
    settings: DifferencesWithinLimits, problem: AttackProblem, state: State, at: Tensor, gradient: Tensor, step: int
) -> State:
    """Adam (Kingma & Ba 2015) on all attacked groups as one vector: the moments, float64 [total], after a gradient,
    float64 [total], and the perturbation `at` [total] moved by it. `step` counts the gradients before this one.
    """
    first = BETAS[0] * state["first"] + (1 - BETAS[0]) * gradient
    second = BETAS[1] * state["second"] + (1 - BETAS[1]) * gradient.square()
    mean, square = first / (1 - BETAS[0] ** (step + 1)), second / (1 - BETAS[1] ** (step + 1))
    rates = problem.layout.spread(settings.learning_rate)
    change = -rates * mean / (square.sqrt() + SMALLEST_DENOMINATOR)
    return {"delta": problem.limits.moved(at, change), "first": first, "second": second}


def draw_directions(kind: str, count: int, total: int, seed: int, step: int) -> Tensor:
    """`count` random directions of a step, float64 [count, total]: ±1 for the kind "signs", else standard normal."""
    import torch

    from scene_attack.attacks.problem import generator

    random = generator(seed, "spsa", step)
    if kind == "signs":
        return 2.0 * torch.randint(0, 2, (count, total), generator=random).double() - 1.0
    return torch.randn(count, total, generator=random, dtype=torch.float64)


def both_ways(
    problem: AttackProblem, at: Tensor, directions: Tensor, half_steps: Tensor, step: int
) -> tuple[Tensor, Tensor]:
    """The change of the objective along directions [n, total], float64 [n], and the distance between both sides,
    float64 [n, total].

    Each side is at ± half_steps [total] · directions from the perturbation `at` [total], clamped to the box. Takes two
    queries a direction. Raises as `AttackProblem.objectives` does.
    """
    moves = directions * half_steps
    forwards, backwards = problem.limits.moved(at, moves), problem.limits.moved(at, -moves)
    both = forwards.repeat_interleave(2, dim=0)  # the two sides of a direction are neighbours
    both[1::2] = backwards
    objectives = problem.objectives(both, step).reshape(-1, 2)
    return objectives[:, 0] - objectives[:, 1], (forwards - backwards).double()


def estimate(
    problem: AttackProblem, at: Tensor, directions: Tensor, half_steps: Tensor, *, gaussian: bool, step: int = 0
) -> Tensor:
    """An estimate of the objective's gradient from each direction alone, float64 [n, total]; see `both_ways`.

    With signs an estimate is the change over the distance of each coordinate, with Gaussian directions the change times
    the direction over twice the half-step. Both are unbiased where the objective is quadratic; within bounds of one
    side only the former is.
    """
    change, distance = both_ways(problem, at, directions, half_steps, step)
    if gaussian:
        return change[:, None] * distance / (2 * half_steps).square()
    quotient = change[:, None] / distance.masked_fill(distance == 0, 1.0)
    return quotient.masked_fill(distance == 0, 0.0)
