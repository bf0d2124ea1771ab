"""Iterative FGSM through the renderer (paper, section 3.2): steps along the gradient's sign, with momentum."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from scene_attack.attacks.attack import Rate, SuggestedRates, register

if TYPE_CHECKING:
    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation


@register
class FGSM(SuggestedRates):
    """Iterative FGSM: steps along the gradient's sign, with momentum and weight decay of the perturbation (paper,
    section 3.2).
    """

    method: Literal["fgsm"] = "fgsm"
    needs_gradient: ClassVar[bool] = True
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(default=120, description="largest number of steps")
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="step size of each group, in the group's units; default: the step that the renderer suggests for "
        "it, for `image` and `torch` the paper's",
    )
    momentum: Annotated[float, Field(ge=0, lt=1)] = Field(default=0.9, description="momentum μ of the signed gradients")
    weight_decay: Annotated[float, Field(ge=0, le=1)] = Field(
        default=1e-4, description="factor on the perturbation that is added to the sign"
    )
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        default=18,
        description="U: largest change of an RGB value from the original inside the loop, in 1/255; null: no limit, "
        "which is the default for a renderer without gradients: silhouettes that move exceed any U at once",
    )

    def init(self, problem: AttackProblem) -> State:
        """Zero velocity."""
        return {"delta": problem.start, "velocity": problem.nothing}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """v ← μ·v + sign(∇ log-odds) + decay·Δ;  Δ ← Δ − η·v, with the η of each group.

        The gradients of the log-odds and of the probability have the same sign, but the probability's vanishes in
        float32 when the network is confident. Weight decay and momentum act on the perturbation, which starts at zero,
        not on the scene's own values.
        """
        assert evaluation.gradient is not None
        delta = evaluation.delta
        change = evaluation.gradient.sign().add(delta, alpha=self.weight_decay)
        velocity = change.add(state["velocity"], alpha=self.momentum)
        rate = problem.layout.spread(self.learning_rate).to(delta.dtype)
        return {"delta": problem.limits.clamp(delta.addcmul(rate, velocity, value=-1)), "velocity": velocity}
