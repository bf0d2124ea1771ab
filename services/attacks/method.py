"""The protocol of an attack method. Its whole state is a set of named tensors, which a checkpoint saves and loads.

`services.attacks.attack.register` registers a method's class. The class is called with the settings and an
`AttackProblem`, whose `beginning` is the method's first perturbation: zeros, or a random one for a restart.
"""

from typing import Protocol

from torch import Tensor

from services.attacks.problem import AttackProblem, Evaluation
from services.rendering.protocol import Parameters


class Method(Protocol):
    """A rule that moves a perturbation from step to step."""

    @property
    def needs_gradient(self) -> bool:
        """Whether `advance` reads `view.gradients`."""
        ...

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group: floating-point, finite, and within the renderer's bounds, which
        `AttackProblem.clamp` sees to. The loop ends the job otherwise: beyond the bounds an image means nothing.
        """
        ...

    def start(self, problem: AttackProblem) -> dict[str, object]:
        """The loop calls this once before the first step, not on resuming. Returns the settings found by measuring,
        as JSON; {} if there are none.
        """
        ...

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Moves the perturbation by one step, given its evaluation `view` and the number `step`, which begins at 0.

        `view.perturbation` is what was evaluated; backtracking may have made it shorter than `perturbation`.

        Returns the number of differences that were below the noise, or of groups whose gradient is zero throughout.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """Every tensor that `advance` depends on, by name."""
        ...

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from a state that `state()` returned."""
        ...
