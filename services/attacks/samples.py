"""The answers and gradients under the variations of a step, over which an attack with an expectation averages."""

from dataclasses import dataclass

import torch
from torch import Tensor

from services.attacks.problem import AttackProblem, Evaluation, gradients
from services.attacks.quantize import quantize
from services.rendering.protocol import Parameters


@dataclass(frozen=True)
class Sampled:
    """The answers to a perturbation under the variations of a step."""

    logits: Tensor
    """Scores of the images rounded to 8 bits, [samples, K]."""
    gradients: list[Parameters]
    """∂objective/∂perturbation of each, by group; none if no gradient was asked for."""

    def answers(self, of_scene: Tensor) -> Tensor:
        """The scores of the scene itself, [K], and of its variations: [1 + samples, K]."""
        return torch.cat([of_scene[None], self.logits]) if len(self.logits) else of_scene[None]


def sample(problem: AttackProblem, view: Evaluation, gradient: bool) -> Sampled:
    """Asks the network about a perturbation under each variation of the step, with gradients if `gradient`.

    Takes a query and an image for each variation. Raises as `AttackProblem.view` and `AttackProblem.logits` do.
    """
    rows, found = [], []
    for variation in problem.variations:
        with problem.under(variation), torch.set_grad_enabled(gradient):
            own = problem.view(view.perturbation, gradient)
            logits = problem.logits(quantize(own.images)[1])
            if gradient:
                found.append(gradients(problem, own, logits))
        rows.append(logits.detach())
    return Sampled(torch.cat(rows) if rows else torch.zeros(0, len(problem.target.labels)), found)


def mean_gradients(of_scene: Parameters, sampled: Sampled) -> Parameters:
    """The mean of the gradients at the scene itself and at its variations, by group."""
    count = 1 + len(sampled.gradients)
    return {group: sum((one[group] for one in sampled.gradients), own) / count for group, own in of_scene.items()}
