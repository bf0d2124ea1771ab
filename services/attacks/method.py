"""The protocol of an attack method. Its whole state is tensors that can be saved and loaded.

`services.attacks.spec.register` makes one known; its class is made of its settings and an `AttackProblem`.
"""

from typing import Protocol

from torch import Tensor

from services.attacks.problem import AttackProblem, Evaluation
from services.rendering.protocol import Parameters


class Method(Protocol):
    """A rule that moves a perturbation from step to step."""

    @property
    def needs_gradient(self) -> bool:
        """Whether `advance` wants a view with a graph."""
        ...

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group."""
        ...

    def start(self, problem: AttackProblem) -> dict[str, object]:
        """Called once before the first step, not on resuming; returns settings that were found by measuring."""
        ...

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Moves the perturbation one step.

        Returns the number of differences that were below the noise, or of groups whose gradient is zero throughout.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """Everything `advance` depends on, by name."""
        ...

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from a state."""
        ...
