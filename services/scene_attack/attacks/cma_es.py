"""CMA-ES (Hansen 2016, package `cmaes`): a population from a Gaussian whose mean and covariance learn what helps."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from scene_attack.attacks.attack import Limit, SearchWithinLimits, in_scale, register

if TYPE_CHECKING:
    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

LARGEST_COVARIANCE = 200
"""Attacks on more coordinates learn a diagonal covariance (separable CMA-ES): a full one needs about the square of the
number of coordinates in queries to be learned, and its cube in time."""
DRAWS = 10
"""Times that a member is drawn until it is within the bounds; then it is clipped to them. Where the optimum is at a
limit of many coordinates, nearly all are clipped, and the package's 100 draws would cost more than the network."""
SPREAD = 1 / 3
"""The default first standard deviation, as a share of a group's scale: three of them end at an ε."""


@register
class CMAES(SearchWithinLimits):
    """Covariance matrix adaptation (Hansen 2016): each step draws a population around the mean, asks the network for
    each member, and moves mean and covariance towards the better half. It needs scores only.
    """

    method: Literal["cma-es"] = "cma-es"
    needs_gradient: ClassVar[bool] = False
    per_group: ClassVar[tuple[str, ...]] = ("spread",)
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(default=100, description="largest number of generations")
    population: Annotated[int, Field(ge=4, le=4096)] | None = Field(
        default=None, description="members of a generation; null: 4 + 3·ln(number of coordinates), rounded down"
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

    def init(self, problem: AttackProblem) -> State:
        """The best member has no objective yet."""
        objective = problem.start.double().new_tensor(inf)
        return {"delta": problem.start, "objective": objective} | _saved(self._optimiser(problem))

    def measured(self, problem: AttackProblem, state: State) -> dict[str, object]:  # noqa: ARG002
        """The size of the population and whether the covariance is diagonal."""
        covariance = "diagonal" if problem.layout.total > LARGEST_COVARIANCE else "full"
        return {"population": self._optimiser(problem).population_size, "covariance": covariance}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """Runs one generation; `delta` is its best member so far.

        Between steps the optimiser exists only as the tensors of the state: each step restores it, with random numbers
        derived from the seed and the step, so an attack that goes on and one that is resumed do the same.
        """
        import numpy as np
        import torch

        from scene_attack.attacks.problem import derived

        optimiser = self._optimiser(problem)
        _restore(optimiser, state)
        optimiser.reseed_rng(derived(problem.seed, "cma-es", evaluation.step) % 2**32)
        drawn = [optimiser.ask() for _ in range(optimiser.population_size)]
        moved = torch.from_numpy(np.stack(drawn)) * problem.layout.spread(self.spread)
        members = problem.feasible(problem.limits.clamp(moved.to(state["delta"].dtype)))
        objectives = problem.objectives(members, evaluation.step)
        optimiser.tell(list(zip(drawn, objectives.tolist(), strict=True)))
        best = {"delta": state["delta"], "objective": state["objective"]}
        winner = int(objectives.argmin())
        if objectives[winner] < best["objective"]:
            best = {"delta": members[winner], "objective": objectives[winner]}
        return best | _saved(optimiser)

    def _optimiser(self, problem: AttackProblem) -> Any:
        """The package's optimiser before its first generation, around the start. Coordinates are divided by the spread
        of their group.
        """
        import numpy as np
        from cmaes import CMA, SepCMA

        kind = SepCMA if problem.layout.total > LARGEST_COVARIANCE else CMA
        spread = problem.layout.spread(self.spread)
        sides = [side.double() / spread for side in (problem.limits.low, problem.limits.high)]
        return kind(
            mean=(problem.start.double() / spread).numpy(),
            sigma=1.0,
            bounds=np.stack(sides, axis=1),
            n_max_resampling=DRAWS,
            seed=0,
            population_size=self.population,
        )


def _saved(optimiser: Any) -> State:
    """The numbers and arrays of an optimiser's state, as it gives them to any serialiser; its generator is not part."""
    import numpy as np
    import torch

    numbers = (np.ndarray, np.number, float, int)
    state = optimiser.__getstate__()
    return {f"optimiser.{n}": torch.as_tensor(value) for n, value in state.items() if isinstance(value, numbers)}


def _restore(optimiser: Any, state: State) -> None:
    """Puts an optimiser of the same arguments into a state that `_saved` returned."""
    saved = {n.removeprefix("optimiser."): value for n, value in state.items() if n.startswith("optimiser.")}
    values = {name: value.numpy().copy() if value.ndim else value.item() for name, value in saved.items()}
    optimiser.__setstate__(optimiser.__getstate__() | values)
