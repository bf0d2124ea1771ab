"""ZOO (Chen et al. 2017; paper, section 3.2): central differences on random coordinates, moved by Adam."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from scene_attack.attacks.attack import Attack, Rate, register, suggested
from scene_attack.errors import JobFailure
from scene_attack.rendering.declaration import RENDERERS

if TYPE_CHECKING:
    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

PRESETS: dict[str, dict[str, Any]] = {
    "paper-classification": {"delta": 1e-4, "learning_rate": 2e-3, "weight": 0.1, "steps": 500},
    "paper-vqa": {"delta": 1e-3, "learning_rate": 1e-2, "weight": 0.5, "steps": 500},
    "measured": {"delta": "measured", "learning_rate": 2e-3, "weight": 0.1, "steps": 500},
}
"""The paper's settings (sections 4.1 and 4.2), and settings of which the difference steps are chosen from the measured
noise. Through a renderer without gradients `measured` has a λ and learning rates of its own."""
WEIGHT = 1e-3
"""λ of `measured` through a renderer without gradients. There objects move, and with the paper's 0.1 the objective
rises: Adam moves every coordinate by its rate, silhouettes with it, and λ times the sum of squares outweighs what that
gains."""
RATE = 2e-3
"""Adam's learning rate there for a group whose renderer suggests no step: the paper's."""
SPEED = 10
"""Adam's learning rate there, in the steps that the renderer suggests for a group. Adam moves by about its rate in a
step, and FGSM by ten of its steps once its momentum of 0.9 has built up."""
BETAS = (0.9, 0.999)
EPSILON = 1e-8
REACH = 10
"""Difference steps are measured at a perturbation of this number of learning rates per coordinate."""

Step = Annotated[float, Field(ge=1e-12, le=1, allow_inf_nan=False)]


@register
class ZOO(Attack):
    """Zeroth-order optimisation: Adam on central differences at random coordinates, of loss + weight·‖ΔY‖² (paper,
    section 3.2).
    """

    method: Literal["zoo"] = "zoo"
    needs_gradient: ClassVar[bool] = False
    per_group: ClassVar[tuple[str, ...]] = ("delta", "learning_rate")
    preset: Literal["paper-classification", "paper-vqa", "measured"] = Field(
        default="measured", description="the set of values from which settings left out are taken"
    )
    coordinates: Annotated[int, Field(ge=1, le=4096)] = Field(
        default=128,
        description="random coordinates that are differenced and moved in each step; all if there are fewer",
    )
    delta: Step | Literal["measured"] | dict[str, Step] = Field(
        default="measured",
        description="half-step of the central difference, in the group's units: one value, or one for each group",
    )
    learning_rate: Rate | dict[str, Rate] = Field(
        default=2e-3,
        description="Adam's learning rate, in the group's units: one value, or one for each group; default through a "
        "renderer without gradients: 10 times the step that it suggests for each group",
    )
    weight: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = Field(
        default=0.1,
        description="λ: weight of the summed squares of the image's change; default through a renderer without "
        "gradients: 0.001",
    )
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        default=None,
        description="U, as for fgsm; null: no limit, as in the paper, which keeps changes small by λ alone",
    )

    @property
    def distance_weight(self) -> float:
        """λ, which is `weight`."""
        return self.weight

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the settings of the preset where they were left out."""
        preset = str(data.get("preset", "measured"))
        renderer = RENDERERS.get(str(data.get("renderer", "torch")))
        if preset == "measured" and renderer is not None and not renderer.differentiable:
            data = {"weight": WEIGHT} | data
            if "learning_rate" not in data:
                data = suggested(data, "learning_rate", lambda group: SPEED * (group.suggested_step or RATE / SPEED))
        return PRESETS.get(preset, {}) | data

    def init(self, problem: AttackProblem) -> State:
        """Measures the objective's noise floor and, for `delta: "measured"`, each group's half-step; finds inactive
        coordinates, which provably change no pixel.
        """
        from scene_attack.attacks.differences import inactive_mask, measure_half_steps, measure_noise

        layout, delta, zeros = problem.layout, problem.start.float(), problem.layout.zeros().double()
        noise, chosen = measure_noise(problem, delta), self.delta
        if isinstance(chosen, str):
            chosen = measure_half_steps(problem, REACH * layout.spread(self.learning_rate), noise)
        half_steps = layout.spread(chosen)
        return {
            "delta": delta,
            "first": zeros,
            "second": zeros,
            "moves": zeros.long(),
            "half_steps": half_steps,
            "noise": zeros.new_tensor(noise),
            "inactive": inactive_mask(problem, delta, half_steps, (None, *problem.variations(0))),
        }

    def measured(self, problem: AttackProblem, state: State) -> dict[str, object]:
        """The half-step of each group as `delta`, the `noise`, and the inactive coordinates, `skipped`."""
        from scene_attack.attacks.differences import settings_of

        looked = (None, *problem.variations(0))
        return {"noise": float(state["noise"])} | settings_of(problem, state["half_steps"], looked)

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """Estimates the gradient at random coordinates and moves only those, each with Adam's moments of its own.

        A coordinate whose difference is below the noise does not move and keeps its moments; such differences are
        counted. Raises JobFailure("non-finite").
        """
        from scene_attack.attacks.differences import active, estimate
        from scene_attack.attacks.problem import draw

        at, step = evaluation.delta.to(state["delta"].dtype), evaluation.step
        half_steps, noise = state["half_steps"], float(state["noise"])
        coordinates = active(problem, at, state["inactive"], half_steps, (None, *problem.variations(step)))
        chosen = draw(coordinates, self.coordinates, problem.seed, "zoo", step)
        estimated = estimate(problem, at, chosen, half_steps[chosen], noise, step)
        if not bool(estimated.gradients.isfinite().all()):
            raise JobFailure("non-finite", "a difference of the objective is not finite")
        moving, gradients = chosen[~estimated.below_noise], estimated.gradients[~estimated.below_noise]
        delta, first, second, moves = (
            value.clone() for value in (at, *(state[n] for n in ("first", "second", "moves")))
        )
        moves[moving] += 1
        first[moving] = BETAS[0] * first[moving] + (1 - BETAS[0]) * gradients
        second[moving] = BETAS[1] * second[moving] + (1 - BETAS[1]) * gradients.square()
        mean = first[moving] / (1 - BETAS[0] ** moves[moving].double())
        square = second[moving] / (1 - BETAS[1] ** moves[moving].double())
        rates = problem.layout.spread(self.learning_rate)[moving]
        delta[moving] -= (rates * mean / (square.sqrt() + EPSILON)).to(delta.dtype)
        return state | {
            "delta": problem.limits.clamp(delta),
            "first": first,
            "second": second,
            "moves": moves,
            "below_noise": estimated.below_noise.sum(),
        }
