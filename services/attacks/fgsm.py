"""Iterative FGSM through the renderer (paper, section 3.2): steps along the gradient's sign, with momentum."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from services.attacks.attack import Rate, SuggestedRates, register

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters


class Fgsm(SuggestedRates):
    """Iterative FGSM: steps along the gradient's sign, with momentum and weight decay of the perturbation (paper,
    section 3.2).
    """

    method: Literal["fgsm"] = "fgsm"
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(120, description="largest number of steps")
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="step size of each group, in the group's units; default: the step that the renderer suggests for "
        "it, for `image` and `torch` the paper's",
    )
    momentum: Annotated[float, Field(ge=0, lt=1)] = Field(0.9, description="momentum μ of the signed gradients")
    weight_decay: Annotated[float, Field(ge=0, le=1)] = Field(
        1e-4, description="factor on the perturbation that is added to the sign"
    )
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        18,
        description="U: largest change of an RGB value from the original inside the loop, in 1/255; null: no limit, "
        "which is the default for a renderer without gradients: silhouettes that move exceed any U at once",
    )


@register(Fgsm)
class FgsmMethod:
    """v ← μ·v + sign(∇ log-odds) + decay·Δ;  Δ ← Δ − η·v, for each group with its own η.

    The gradients of the log-odds and of the probability have the same sign, but the probability's vanishes in float32
    when the network is confident. Weight decay and momentum act on the perturbation, which starts at zero, not on the
    scene's own values.
    """

    needs_gradient = True

    def __init__(self, settings: Fgsm, problem: AttackProblem) -> None:
        self.settings = settings
        self.perturbation: Parameters = problem.beginning
        self.velocity: Parameters = problem.nothing()

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """FGSM measures no settings."""
        return {}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:  # noqa: ARG002
        """Takes one step along `view.gradients`. Returns the number of groups whose gradient is zero throughout."""
        moved = {}
        for group, seen in view.perturbation.items():
            delta = seen.detach()
            change = view.gradients[group].sign().add_(delta, alpha=self.settings.weight_decay)
            self.velocity[group] = change.add_(self.velocity[group], alpha=self.settings.momentum)
            moved[group] = delta.sub(self.velocity[group], alpha=self.settings.learning_rate[group])
        self.perturbation = problem.clamp(moved)
        return view.n_flat

    def state(self) -> dict[str, Tensor]:
        """The perturbation and the velocity of each group."""
        named = {f"perturbation.{g}": v for g, v in self.perturbation.items()}
        return named | {f"velocity.{g}": v for g, v in self.velocity.items()}

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.perturbation = {g: state[f"perturbation.{g}"] for g in self.perturbation}
        self.velocity = {g: state[f"velocity.{g}"] for g in self.velocity}
