"""Iterative FGSM through the renderer (paper, section 3.2): the sign of the gradient, with momentum."""

import torch
from torch import Tensor

from services.attacks.problem import AttackProblem, Evaluation
from services.attacks.spec import Fgsm
from services.rendering.protocol import Parameters


class FgsmMethod:
    """v ← μ·v + sign(∇ log-odds) + decay·Δ;  Δ ← Δ − η·v, for each group with its own η.

    The sign of the gradient of the log-odds is that of the probability, without its dead zone on confident networks.
    Weight decay and momentum act on the perturbation, which starts at zero, not on the scene's own values.
    """

    needs_gradient = True

    def __init__(self, settings: Fgsm, problem: AttackProblem) -> None:
        self.settings = settings
        self.perturbation: Parameters = problem.nothing()
        self.velocity: Parameters = problem.nothing()

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """Nothing to measure."""
        return {}

    @torch.no_grad()
    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:  # noqa: ARG002
        """One step along the view's slopes. Returns how many groups have none: all of the group's slopes are zero."""
        moved = {}
        for group, seen in view.perturbation.items():
            change = view.slopes[group].sign().add_(seen, alpha=self.settings.weight_decay)
            self.velocity[group] = change.add_(self.velocity[group], alpha=self.settings.momentum)
            moved[group] = seen.sub(self.velocity[group], alpha=self.settings.learning_rate[group])
        self.perturbation = problem.clamp(moved)
        return sum(bool(slope.min() == slope.max() == 0) for slope in view.slopes.values())

    def state(self) -> dict[str, Tensor]:
        """Perturbation and velocity."""
        named = {f"perturbation.{g}": v for g, v in self.perturbation.items()}
        return named | {f"velocity.{g}": v for g, v in self.velocity.items()}

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.perturbation = {g: state[f"perturbation.{g}"] for g in self.perturbation}
        self.velocity = {g: state[f"velocity.{g}"] for g in self.velocity}
