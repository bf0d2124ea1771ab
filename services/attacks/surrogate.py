"""A surrogate: another network whose gradients guide the search against a network that gives scores only."""

from dataclasses import dataclass

from services.attacks.goal import ResolvedGoal
from services.targets.protocol import Target


@dataclass(frozen=True)
class Surrogate:
    """A network with gradients, and the attack's goal in its own labels. `prior` takes its gradients."""

    target: Target
    goal: ResolvedGoal
