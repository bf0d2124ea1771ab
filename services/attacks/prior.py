"""The gradient of a surrogate, which guides the search against a network that gives scores only."""

from dataclasses import replace

import torch
from torch import Tensor

from services.attacks.image_differences import ImageDifferences
from services.attacks.problem import AttackProblem, gradients, quantize
from services.attacks.run import mean_gradients, sample
from services.rendering.protocol import Parameters


class Prior:
    """The gradient of the surrogate's margin with respect to the parameters of a problem.

    Through a renderer without gradients it is taken by differences of its images (`image_differences`), which ask the
    network under attack nothing. The surrogate's queries are counted in the problem's `surrogate_queries`, its images
    among the problem's `renders`.
    """

    def __init__(self, problem: AttackProblem) -> None:
        assert problem.surrogate is not None
        surrogate = problem.surrogate
        self.own = replace(
            problem,
            target=surrogate.target,
            goal=surrogate.goal,
            loss="margin",
            weight=0.0,
            surrogate=None,
            queries=0,
            renders=0,
        )

    def measure(self, problem: AttackProblem) -> dict[str, object]:
        """Prepares differences of images if the renderer needs them. Returns their settings, as JSON."""
        settings: dict[str, object] = {}
        if not problem.renderer.differentiable:
            differences = ImageDifferences.measure(self.own)
            self.own.differences, settings = differences, differences.settings(self.own)
        self._count(problem)
        return settings

    def load(self, half_steps: Tensor) -> None:
        """Goes on with the half-steps, float64 [total], that `half_steps` returned; [0] if there were none."""
        layout = self.own.layout
        if len(half_steps):
            by_group = {group: float(half_steps[layout.starts[group]]) for group in layout.groups}
            self.own.differences = ImageDifferences(self.own, by_group)
        self.own.queries = self.own.renders = 0  # counted before the checkpoint

    @property
    def half_steps(self) -> Tensor:
        """The half-steps of the differences of images, float64 [total]; [0] if there are none."""
        differences = self.own.differences
        return differences.half_steps if isinstance(differences, ImageDifferences) else torch.zeros(0).double()

    def gradient(self, problem: AttackProblem, perturbation: Parameters) -> Tensor:
        """∂margin/∂perturbation at a perturbation, float64 [total], the mean over the variations of the step if it has
        any. Takes one query of the surrogate for each.
        """
        self.own.variations = problem.variations
        with torch.enable_grad():
            view = self.own.view(perturbation, gradient=True)
            logits = self.own.logits(quantize(view.images)[1])
        of_scene = gradients(self.own, view, logits)
        found = mean_gradients(of_scene, sample(self.own, view, gradient=True))
        self._count(problem)
        return self.own.layout.flatten(found).double()

    def _count(self, problem: AttackProblem) -> None:
        problem.surrogate_queries += self.own.queries
        problem.renders += self.own.renders
        self.own.queries = self.own.renders = 0
