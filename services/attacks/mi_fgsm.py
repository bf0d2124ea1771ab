"""MI-FGSM (Dong et al. 2018): steps along the sign of a momentum of normalised gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from services.attacks.attack import Rate, SuggestedRates, register
from services.attacks.losses import DESCRIPTION, Loss

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters


class MiFgsm(SuggestedRates):
    """Momentum iterative FGSM (Dong et al. 2018): gradients divided by their ℓ1 norm are accumulated, and each step is
    along the sign of the sum.
    """

    method: Literal["mi-fgsm"] = "mi-fgsm"
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(120, description="largest number of steps")
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="step size of each group, in the group's units; default: the step of fgsm",
    )
    decay: Annotated[float, Field(ge=0, le=10)] = Field(
        1.0, description="decay factor μ of the accumulated gradients; 0: the last gradient alone"
    )
    loss: Loss = Field("log-odds", description=DESCRIPTION)
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        18, description="U: largest change of an RGB value from the original inside the loop, in 1/255; null: no limit"
    )

    @property
    def objective(self) -> Loss:
        """The loss whose gradient the loop computes."""
        return self.loss


@register(MiFgsm)
class MiFgsmMethod:
    """g ← μ·g + ∇/‖∇‖₁;  Δ ← Δ − η·sign(g), for each group with its own norm and η."""

    needs_gradient = True

    def __init__(self, settings: MiFgsm, problem: AttackProblem) -> None:
        self.settings = settings
        self.perturbation: Parameters = problem.beginning
        self.accumulated: Parameters = problem.nothing()

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """MI-FGSM measures no settings."""
        return {}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:  # noqa: ARG002
        """Takes one step. Returns the number of groups whose gradient is zero throughout, which add nothing."""
        moved, zero = {}, 0
        for group, gradient in view.gradients.items():
            # a sum of a hundred thousand small values, of which float32 would keep four digits
            norm = float(gradient.abs().double().sum())
            zero += norm == 0
            kept = self.accumulated[group] * self.settings.decay
            self.accumulated[group] = kept if norm == 0 else kept + gradient / norm
            step_size = self.settings.learning_rate[group]
            moved[group] = view.perturbation[group].detach() - step_size * self.accumulated[group].sign()
        self.perturbation = problem.clamp(moved)
        return zero

    def state(self) -> dict[str, Tensor]:
        """The perturbation and the accumulated gradient of each group."""
        named = {f"perturbation.{g}": v for g, v in self.perturbation.items()}
        return named | {f"accumulated.{g}": v for g, v in self.accumulated.items()}

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.perturbation = {g: state[f"perturbation.{g}"] for g in self.perturbation}
        self.accumulated = {g: state[f"accumulated.{g}"] for g in self.accumulated}
