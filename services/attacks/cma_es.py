"""CMA-ES (Hansen 2016, package `cmaes`): a population from a Gaussian whose mean and covariance learn what helps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from services.attacks.attack import Limit, SearchWithinLimits, in_scale, register

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters

LARGEST_COVARIANCE = 200
"""Attacks on more coordinates learn a diagonal covariance (separable CMA-ES): a full one needs about the square of the
number of coordinates in queries to be learned, and its cube in time."""
DRAWS = 10
"""Times that a member is drawn until it is within the bounds; then it is clipped to them. Where the optimum is at a
limit of many coordinates, nearly all are clipped, and the package's 100 draws would cost more than the network."""
SPREAD = 1 / 3
"""The default first standard deviation, as a share of a group's scale: three of them end at an ε."""


class CmaEs(SearchWithinLimits):
    """Covariance matrix adaptation (Hansen 2016): each step draws a population around the mean, asks the network for
    each member, and moves mean and covariance towards the better half. It needs scores only.
    """

    method: Literal["cma-es"] = "cma-es"
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(100, description="largest number of generations")
    population: Annotated[int, Field(ge=4, le=4096)] | None = Field(
        None, description="members of a generation; null: 4 + 3·ln(number of coordinates), rounded down"
    )
    spread: dict[str, Limit] = Field(
        default_factory=dict,
        description="first standard deviation of each group, in the group's units; default: a third of its `epsilon`, "
        "without one 20 of the steps that its renderer suggests",
    )

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the limits that the search needs, and the spreads."""
        return in_scale(super().complete(data), "spread", SPREAD)

    @model_validator(mode="after")
    def _a_value_for_each_group(self) -> Self:
        self.check_groups("spread", self.spread)
        return self


@register(CmaEs)
class CmaEsMethod:
    """The perturbation is the best member so far. Coordinates are divided by their group's spread.

    Between steps the optimiser exists only as the tensors of `state()`: each step restores it, with random numbers
    derived from the seed and the step, so an attack that goes on and one that is resumed do the same.
    """

    needs_gradient = False

    def __init__(self, settings: CmaEs, problem: AttackProblem) -> None:
        import torch

        self.settings = settings
        self.layout = problem.layout
        self.best = self.layout.flatten(problem.beginning)
        self.best_objective = torch.tensor(torch.inf, dtype=torch.float64)
        self.spread = self.layout.spread(settings.spread)
        self.begin = (self.best.double() / self.spread).numpy()
        far = torch.full_like(self.best, torch.inf)
        sides = [self.layout.flatten(problem.clamp(self.layout.unflatten(end))) for end in (-far, far)]
        self.bounds = torch.stack([side.double() / self.spread for side in sides], dim=1).numpy()
        self.optimiser = _saved(self._new())

    @property
    def perturbation(self) -> Parameters:
        """The best perturbation so far, by group."""
        return self.layout.unflatten(self.best)

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """Returns the size of the population and whether the covariance is diagonal."""
        optimiser = self._new()
        return {"population": optimiser.population_size, "covariance": "diagonal" if self._diagonal else "full"}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:  # noqa: ARG002
        """Runs one generation. Returns 0: no difference is taken."""
        import numpy as np
        import torch

        from services.attacks.differences import clamped, evaluate
        from services.attacks.seeds import derived

        optimiser = self._new()
        _restore(optimiser, self.optimiser)
        optimiser.reseed_rng(derived(problem.seed, "cma-es", step) % 2**32)
        drawn = [optimiser.ask() for _ in range(optimiser.population_size)]
        moved = torch.from_numpy(np.stack(drawn)) * self.spread
        members = problem.feasible(clamped(problem, moved.to(self.best.dtype)))
        objectives = evaluate(problem, members)
        optimiser.tell(list(zip(drawn, objectives.tolist(), strict=True)))
        self.optimiser = _saved(optimiser)
        winner = int(objectives.argmin())
        if objectives[winner] < self.best_objective:
            self.best, self.best_objective = members[winner], objectives[winner]
        return 0

    def state(self) -> dict[str, Tensor]:
        """The best member and its objective, and the optimiser's mean, covariance, paths, step size and generation."""
        optimiser = {f"optimiser.{name}": value for name, value in self.optimiser.items()}
        return {"best": self.best, "best_objective": self.best_objective} | optimiser

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.best, self.best_objective = state["best"], state["best_objective"]
        self.optimiser = {n.removeprefix("optimiser."): v for n, v in state.items() if n.startswith("optimiser.")}

    @property
    def _diagonal(self) -> bool:
        return self.layout.total > LARGEST_COVARIANCE

    def _new(self) -> Any:
        from cmaes import CMA, SepCMA

        kind = SepCMA if self._diagonal else CMA
        return kind(
            mean=self.begin.copy(),
            sigma=1.0,
            bounds=self.bounds,
            n_max_resampling=DRAWS,
            seed=0,
            population_size=self.settings.population,
        )


def _saved(optimiser: Any) -> dict[str, Tensor]:
    """The numbers and arrays of an optimiser's state, as it gives them to any serialiser; its generator is not part."""
    import numpy as np
    import torch

    numbers = (np.ndarray, np.number, float, int)
    state = optimiser.__getstate__()
    return {name: torch.as_tensor(value) for name, value in state.items() if isinstance(value, numbers)}


def _restore(optimiser: Any, saved: dict[str, Tensor]) -> None:
    """Puts an optimiser of the same arguments into a state that `_saved` returned."""
    values = {name: value.numpy().copy() if value.ndim else value.item() for name, value in saved.items()}
    optimiser.__setstate__(optimiser.__getstate__() | values)
