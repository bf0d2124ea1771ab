"""P-RGF (Cheng et al. 2019, 2021): random gradient-free search whose directions include a surrogate's gradient."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scene_attack.attacks.attack import DifferencesWithinLimits, Rate, register
from scene_attack.attacks.spsa import both_ways, draw_directions, moved_by_adam
from scene_attack.strict import reference

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

DEPENDENT = 1e-8
"""Eigenvalues of the directions' Gram matrix below this share of the largest are treated as 0."""


@register
class PRGF(DifferencesWithinLimits):
    """Prior-guided random gradient-free search (Cheng et al. 2019, in the form of Cheng, Wu and Zhu 2021): the
    gradient is projected onto the span of random directions and of a surrogate's gradient, and moved by Adam. It needs
    scores only; the gradient is that of another target.
    """

    method: Literal["p-rgf"] = "p-rgf"
    needs_gradient: ClassVar[bool] = False
    surrogate: Annotated[str, Field(min_length=1, max_length=100), reference("target")] | None = Field(
        default=None,
        description="another target, whose scores have gradients: the direction of its gradient is tried at each step "
        "beside the random ones; null: random directions alone",
    )
    rate_in_scale: ClassVar[float] = 1 / 4
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="Adam's learning rate of each group, in the group's units; default: 1/4 of its `epsilon`, without "
        "one 15 of the steps that its renderer suggests",
    )
    pairs: Annotated[int, Field(ge=0, le=4096)] = Field(
        default=4,
        description="random directions of a step, each evaluated forwards and backwards: 2 queries, as the "
        "surrogate's direction is; 0 only with a surrogate",
    )

    @model_validator(mode="after")
    def _some_direction(self) -> Self:
        if self.pairs == 0 and self.surrogate is None:
            raise ValueError("pairs: without a surrogate there is no direction but random ones; ask for 1 or more")
        return self

    @property
    def guide(self) -> str | None:
        """The surrogate."""
        return self.surrogate

    def init(self, problem: AttackProblem) -> State:
        """Adam's moments are zero; the half-steps of the surrogate's gradient are measured where they are needed."""
        zeros = problem.start.new_zeros(problem.layout.total).double()
        state = {"delta": problem.start, "first": zeros, "second": zeros}
        return state if problem.surrogate is None else state | measured_half_steps(problem)

    def measured(self, problem: AttackProblem, state: State) -> dict[str, object]:
        """Settings of the surrogate's gradient, as `surrogate`: those of differences of images, or {}."""
        if problem.surrogate is None:
            return {}
        differences = surrogate_problem(problem, state).differences
        return {"surrogate": {} if differences is None else differences.settings(problem)}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """Projects the gradient onto the span of the directions and moves all coordinates by Adam. Counts the
        directions along which the objective does not change.
        """
        import torch

        at, step = evaluation.delta, evaluation.step
        half_steps, total = problem.layout.spread(self.delta), problem.layout.total
        directions = draw_directions("signs", self.pairs, total, problem.seed, step)
        if problem.surrogate is not None:
            prior = surrogate_gradient(problem, state, at, step) * half_steps
            if bool(prior.any()):  # of the same length as a direction of signs
                directions = torch.cat([(prior / prior.norm() * total**0.5)[None], directions])
        gradient, still = projected_gradient(problem, at, directions, half_steps, step)
        return state | moved_by_adam(self, problem, state, at, gradient, step) | {"below_noise": still}


def projected_gradient(
    problem: AttackProblem, at: Tensor, directions: Tensor, half_steps: Tensor, step: int = 0
) -> tuple[Tensor, Tensor]:
    """The gradient of the objective, projected onto the span of directions; and the number of directions along which
    the objective does not change.

    `at` [total] is the perturbation; each side of a difference is at ± half_steps [total] · directions [n, total],
    clamped to the box. Returns ∂objective/∂x, float64 [total]. Raises as `AttackProblem.objectives` does.

    With the half-steps as units, the result is the shortest vector whose product with each displacement is the measured
    change: of all combinations of the directions the one closest to the gradient (Cheng, Wu and Zhu 2021), whatever the
    angles between them, and the gradient itself once they span the space. It costs two queries for each direction.
    """
    import torch

    if not len(directions):
        return torch.zeros_like(half_steps), torch.tensor(0)
    change, distance = both_ways(problem, at, directions, half_steps, step)
    displacements = distance / half_steps
    gram = displacements @ displacements.T
    weights = torch.linalg.pinv(gram, rtol=DEPENDENT, hermitian=True) @ change
    return weights @ displacements / half_steps, (change == 0).sum()


def surrogate_problem(problem: AttackProblem, state: State) -> AttackProblem:
    """The problem of lowering the surrogate's margin, with counts of its own."""
    from scene_attack.attacks.differences import ImageDifferences
    from scene_attack.attacks.problem import Counts

    assert problem.surrogate is not None
    differences = None
    if "surrogate_half_steps" in state:
        differences = ImageDifferences(state["surrogate_half_steps"], state["surrogate_inactive"])
    return replace(
        problem,
        target=problem.surrogate.target,
        goal=problem.surrogate.goal,
        loss="margin",
        distance_weight=0.0,
        differences=differences,
        counts=Counts(),
    )


def measured_half_steps(problem: AttackProblem) -> State:
    """The half-steps of the surrogate's gradient through a renderer without gradients, by differences of its images,
    which ask the network under attack nothing; {} for another renderer.
    """
    from scene_attack.attacks.differences import ImageDifferences

    if problem.renderer.differentiable:
        return {}
    own = surrogate_problem(problem, {})
    differences = ImageDifferences.measure(own)
    count(problem, own)
    return {"surrogate_half_steps": differences.half_steps, "surrogate_inactive": differences.inactive}


def surrogate_gradient(problem: AttackProblem, state: State, delta: Tensor, step: int) -> Tensor:
    """∂margin/∂delta of the surrogate at a perturbation, float64 [total], the mean over the variations of the step if
    it has any. Takes one query of the surrogate for each.
    """
    from scene_attack.attacks.problem import differentiate, evaluate

    own = surrogate_problem(problem, state)
    gradient = differentiate(own, evaluate(own, delta, step, gradient=True)).gradient
    count(problem, own)
    assert gradient is not None
    return gradient.double()


def count(problem: AttackProblem, own: AttackProblem) -> None:
    """Counts what the surrogate's problem took: its queries apart, its images among the attack's."""
    problem.counts.surrogate_queries += own.counts.queries
    problem.counts.renders += own.counts.renders
