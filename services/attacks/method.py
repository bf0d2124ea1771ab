"""What the loop needs of an attack method. A method is its state: tensors that can be saved and loaded."""

from typing import Protocol

from torch import Tensor

from services.attacks.problem import AttackProblem, Evaluation
from services.rendering.protocol import Parameters


class Method(Protocol):
    """One way of moving a perturbation."""

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

        Returns how much of what it went by said nothing: differences below the noise, or groups all of whose slopes
        are zero.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """Everything `advance` depends on, by name."""
        ...

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from a state."""
        ...
