"""P-RGF (Cheng et al. 2019, 2021): random gradient-free search whose directions include a surrogate's gradient."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from services.attacks.attack import DifferencesWithinLimits, Rate, register
from services.names import reference

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters

DEPENDENT = 1e-8
"""Eigenvalues of the directions' Gram matrix below this share of the largest are treated as 0."""


class PRgf(DifferencesWithinLimits):
    """Prior-guided random gradient-free search (Cheng et al. 2019, in the form of Cheng, Wu and Zhu 2021): the
    gradient is projected onto the span of random directions and of a surrogate's gradient, and moved by Adam. It needs
    scores only; the gradient is that of another target.
    """

    method: Literal["p-rgf"] = "p-rgf"
    surrogate: Annotated[str, Field(min_length=1, max_length=100), reference("target")] | None = Field(
        None,
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
        4,
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


@register(PRgf)
class PRgfMethod:
    """Each step projects the gradient onto the span of its directions and moves all coordinates by Adam."""

    needs_gradient = False

    def __init__(self, settings: PRgf, problem: AttackProblem) -> None:
        from services.attacks.adam import Adam
        from services.attacks.prior import Prior

        self.settings = settings
        self.layout = problem.layout
        self.delta = self.layout.flatten(problem.beginning)
        self.half_steps = self.layout.spread(settings.delta)
        self.adam = Adam(self.layout.spread(settings.learning_rate))
        self.prior = None if problem.surrogate is None else Prior(problem)

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group."""
        return self.layout.unflatten(self.delta)

    def start(self, problem: AttackProblem) -> dict[str, object]:
        """Returns what the surrogate's gradient is taken by, as `surrogate`: differences of images, or {}."""
        return {} if self.prior is None else {"surrogate": self.prior.measure(problem)}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Takes one step. Returns the number of directions along which the objective does not change."""
        import torch

        from services.attacks.differences import moved
        from services.attacks.spsa import draw_directions

        at = self.layout.flatten(view.perturbation)
        directions = draw_directions("signs", self.settings.pairs, self.layout.total, problem.seed, step)
        if self.prior is not None:
            prior = self.prior.gradient(problem, view.perturbation) * self.half_steps
            if bool(prior.any()):  # of the same length as a direction of signs
                prior = prior / prior.norm() * self.layout.total**0.5
                directions = torch.cat([prior[None], directions])
        gradient, still = projected_gradient(problem, at, directions, self.half_steps)
        self.delta = moved(problem, at, self.adam.change(gradient, step)[None])[0]
        return still

    def state(self) -> dict[str, Tensor]:
        """The perturbation, Adam's moments, and the half-steps of the surrogate's gradient."""
        prior = {} if self.prior is None else {"prior_half_steps": self.prior.half_steps}
        return {"delta": self.delta} | self.adam.state() | prior

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.delta = state["delta"]
        self.adam.load(state)
        if self.prior is not None:
            self.prior.load(state["prior_half_steps"])


def projected_gradient(
    problem: AttackProblem, at: Tensor, directions: Tensor, half_steps: Tensor
) -> tuple[Tensor, int]:
    """The gradient of the objective, projected onto the span of directions; and the number of directions along which
    the objective does not change.

    `at` [total] is the perturbation; each side of a difference is at ± half_steps [total] · directions [n, total],
    clamped to the bounds. Returns ∂objective/∂x, float64 [total]. Raises as `evaluate` does.

    With the half-steps as units, the result is the shortest vector whose product with each displacement is the measured
    change: of all combinations of the directions the one closest to the gradient (Cheng, Wu and Zhu 2021), whatever the
    angles between them, and the gradient itself once they span the space. It costs two queries for each direction.
    """
    import torch

    from services.attacks.differences import evaluate, moved

    if not len(directions):
        return torch.zeros_like(half_steps), 0
    moves = directions * half_steps
    forwards, backwards = (moved(problem, at, sign * moves) for sign in (1.0, -1.0))
    objectives = evaluate(problem, torch.stack([forwards, backwards], dim=1).flatten(0, 1)).reshape(-1, 2)
    change = objectives[:, 0] - objectives[:, 1]
    displacements = (forwards - backwards).double() / half_steps
    gram = displacements @ displacements.T
    weights = torch.linalg.pinv(gram, rtol=DEPENDENT, hermitian=True) @ change
    return weights @ displacements / half_steps, int((change == 0).sum())
