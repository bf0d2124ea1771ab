"""MI-FGSM (Dong et al. 2018): steps along the sign of a momentum of normalised gradients."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from scene_attack.attacks.attack import Rate, SuggestedRates, register
from scene_attack.attacks.request import LOSS_DESCRIPTION, Loss

if TYPE_CHECKING:
    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation


@register
class MIFGSM(SuggestedRates):
    """Momentum iterative FGSM (Dong et al. 2018): gradients divided by their ℓ1 norm are accumulated, and each step is
    along the sign of the sum.
    """

    method: Literal["mi-fgsm"] = "mi-fgsm"
    needs_gradient: ClassVar[bool] = True
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(default=120, description="largest number of steps")
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="step size of each group, in the group's units; default: the step of fgsm",
    )
    decay: Annotated[float, Field(ge=0, le=10)] = Field(
        default=1.0, description="decay factor μ of the accumulated gradients; 0: the last gradient alone"
    )
    loss: Loss = Field(default="log-odds", description=LOSS_DESCRIPTION)
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        default=18,
        description="U: largest change of an RGB value from the original inside the loop, in 1/255; null: no limit",
    )

    @property
    def objective(self) -> Loss:
        """The loss whose gradient the loop computes."""
        return self.loss

    def init(self, problem: AttackProblem) -> State:
        """No gradient is accumulated yet."""
        return {"delta": problem.start, "accumulated": problem.nothing}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """g ← μ·g + ∇/‖∇‖₁;  Δ ← Δ − η·sign(g), for each group with its own norm and η. Zero gradients add nothing."""
        assert evaluation.gradient is not None
        delta, layout = evaluation.delta, problem.layout
        # a sum of a hundred thousand small values, of which float32 would keep four digits
        norms = {g: float(v.abs().double().sum()) or inf for g, v in layout.unflatten(evaluation.gradient).items()}
        direction = evaluation.gradient / layout.spread(norms).to(delta.dtype)
        accumulated = state["accumulated"] * self.decay + direction
        rate = layout.spread(self.learning_rate).to(delta.dtype)
        return {"delta": problem.limits.clamp(delta - rate * accumulated.sign()), "accumulated": accumulated}
