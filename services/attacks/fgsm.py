"""Iterative FGSM through the renderer (paper, section 3.2): the sign of the gradient, with momentum."""

import torch
from torch import Tensor

from services.attacks.problem import Problem, View
from services.attacks.spec import Fgsm
from services.errors import JobFailure
from services.rendering.protocol import Parameters


class FgsmMethod:
    """v ← μ·v + sign(∇ log-odds) + decay·Δ;  Δ ← Δ − η·v, for each group with its own η.

    The sign of the gradient of the log-odds is that of the probability, without its dead zone on confident networks.
    Weight decay and momentum act on the perturbation, which starts at zero, not on the scene's own values.
    """

    needs_gradient = True

    def __init__(self, settings: Fgsm, problem: Problem) -> None:
        self.settings = settings
        self.perturbation: Parameters = problem.nothing()
        self.velocity: Parameters = problem.nothing()

    def start(self, problem: Problem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """Nothing to measure."""
        return {}

    def advance(self, problem: Problem, view: View, step: int) -> int:  # noqa: ARG002
        """One step from a view whose graph leads to the perturbation. Returns how many groups have no slope at all."""
        objective = problem.goal.objective(problem.logits(view.images)).sum()
        leaves = [view.perturbation[group] for group in problem.groups]
        # zeros where every pixel is held back, or out of the parameter's reach
        gradients = torch.autograd.grad(objective, leaves, materialize_grads=True)
        with torch.no_grad():
            for group, leaf, gradient in zip(problem.groups, leaves, gradients, strict=True):
                if not bool(torch.isfinite(gradient).all()):
                    raise JobFailure("non-finite", f"the gradient of group {group!r} has values that are not finite")
                change = gradient.sign() + self.settings.weight_decay * leaf
                self.velocity[group] = self.settings.momentum * self.velocity[group] + change
                self.perturbation[group] = leaf.detach() - self.settings.learning_rate[group] * self.velocity[group]
            self.perturbation = problem.clamp(self.perturbation)
        return sum(not bool(gradient.any()) for gradient in gradients)

    def state(self) -> dict[str, Tensor]:
        """Perturbation and velocity."""
        named = {f"perturbation.{g}": v.detach() for g, v in self.perturbation.items()}
        return named | {f"velocity.{g}": v for g, v in self.velocity.items()}

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.perturbation = {g: state[f"perturbation.{g}"] for g in self.perturbation}
        self.velocity = {g: state[f"velocity.{g}"] for g in self.velocity}
