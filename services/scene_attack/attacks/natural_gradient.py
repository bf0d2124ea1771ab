"""Natural gradient through a renderer without gradients: the steepest descent for each unit of perceptibility."""

from __future__ import annotations

from math import inf, sqrt
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scene_attack.attacks.attack import Attack, register
from scene_attack.rendering.declaration import RENDERERS

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

RADIUS = 0.01
"""Default p of the first step where the request states no largest p."""
RADIUS_IN_LIMIT = 0.25
"""Default p of the first step as a share of the largest p."""
GROWTH, CUT = 1.5, 0.5
"""Factors on the radius after a step that lowered the objective, and after one that did not."""
MOST_GROWTH, LEAST = 2.0, 1 / 64
"""Range of the radius in first radii. Below it the radius begins anew."""
DAMPING, LEAST_DAMPING, MOST_DAMPING = 0.3, 0.03, 30.0
"""First damping and its range, as shares of the metric's diagonal."""
RAISE, RELAX = 3.0, 3.0**-0.5
"""Factors on the damping after a step that did not lower the objective, and after one that did."""


@register
class NaturalGradient(Attack):
    """Natural gradient (Amari 1998) in the metric of perceptibility, with a trust region: of all steps whose image
    changes by the same p, the one that lowers the objective most to first order. It uses the differences of images from
    which the gradient is taken anyway, so it is for renderers without gradients.
    """

    method: Literal["natural-gradient"] = "natural-gradient"
    needs_gradient: ClassVar[bool] = True
    needs_metric: ClassVar[bool] = True
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(default=30, description="largest number of steps")
    radius: Annotated[float, Field(gt=0, le=sqrt(3), allow_inf_nan=False)] = Field(
        default=RADIUS,
        description="p by which the first step changes the image; later ones between 1/64 of it and twice it; default: "
        f"a quarter of `perceptibility`, or {RADIUS:g} without it",
    )

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the radius that follows from the largest p."""
        limit = data.get("perceptibility")
        if "radius" in data or not isinstance(limit, int | float) or not limit > 0:
            return data
        return data | {"radius": RADIUS_IN_LIMIT * limit}

    @model_validator(mode="after")
    def _through_differences_of_one_image(self) -> Self:
        if RENDERERS[self.renderer].differentiable:
            can = ", ".join(name for name, declaration in RENDERERS.items() if not declaration.differentiable)
            raise ValueError(
                f"renderer: natural-gradient takes differences of images, for renderers without gradients ({can}); "
                "use fgsm or apgd"
            )
        if self.expectation is not None:
            raise ValueError("expectation: the metric of natural-gradient is that of one image; use fgsm or mi-fgsm")
        return self

    def init(self, problem: AttackProblem) -> State:
        """The best perturbation has no objective yet. `region` is its objective, the radius and the damping."""
        numbers, total = problem.start.double(), problem.layout.total
        return {
            "delta": problem.start,
            "best": problem.start,
            "gradient": numbers.new_zeros(total),
            "metric": numbers.new_zeros(total, total),
            "region": numbers.new_tensor([inf, self.radius, DAMPING]),
        }

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """d ∝ −(M + μ·diag M)⁻¹ ∇f, scaled to dᵀMd = r², from the best perturbation so far.

        M is the metric: dᵀMd is the square of the p that a small step d changes the image by. The damping μ (Levenberg
        and Marquardt) and the radius r (a trust region) follow from whether the last step lowered the objective:
        silhouettes that cross pixels make differences of images and the objective disagree.
        """
        assert evaluation.gradient is not None
        assert evaluation.metric is not None
        best, gradient, metric = state["best"], state["gradient"], state["metric"]
        least, radius, damping = state["region"].tolist()
        if evaluation.objective < least:
            best, gradient = evaluation.delta, evaluation.gradient.double().cpu()
            metric, least = evaluation.metric, evaluation.objective
            if evaluation.step:
                radius = min(GROWTH * radius, MOST_GROWTH * self.radius)
                damping = max(RELAX * damping, LEAST_DAMPING)
        else:
            radius, damping = CUT * radius, min(RAISE * damping, MOST_DAMPING)
            if radius < LEAST * self.radius:
                radius = self.radius
        return {
            "delta": problem.limits.moved(best, radius * steepest(gradient, metric, damping)),
            "best": best,
            "gradient": gradient,
            "metric": metric,
            "region": state["region"].new_tensor([least, radius, damping]),
        }


def steepest(gradient: Tensor, metric: Tensor, damping: float) -> Tensor:
    """The direction d [total], float64, that lowers a function of this gradient [total] most for its length in the
    metric [total, total]; dᵀ·metric·d is 1. Zeros where the gradient is zero or changes nothing of the image.

    It solves (M + damping·diag M) d = −∇f in coordinates scaled to a diagonal of 1, so that a group's unit does not
    matter. Coordinates that change nothing stay where they are.
    """
    import torch

    scale = metric.diagonal().sqrt()
    live = scale > 0
    scale = scale.where(live, torch.ones_like(scale))
    alike = metric / scale[:, None] / scale
    alike = alike + torch.diag(damping * live + (~live).double())
    direction = -torch.linalg.solve(alike, gradient / scale * live) / scale
    length = float((direction @ metric @ direction).sqrt())
    return direction / length if length > 0 else torch.zeros_like(direction)
