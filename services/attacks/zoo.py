"""ZOO (Chen et al. 2017; paper, section 3.2): central differences on random coordinates, moved by Adam."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from services.attacks.attack import AttackSettings, Rate, register, suggested
from services.errors import JobFailure
from services.rendering.declaration import RENDERERS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import InactiveCoordinate, Parameters

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


class Zoo(AttackSettings):
    """Zeroth-order optimisation: Adam on central differences at random coordinates, of loss + weight·‖ΔY‖² (paper,
    section 3.2).
    """

    method: Literal["zoo"] = "zoo"
    preset: Literal["paper-classification", "paper-vqa", "measured"] = Field(
        "measured", description="the set of values from which settings left out are taken"
    )
    coordinates: Annotated[int, Field(ge=1, le=4096)] = Field(
        128, description="random coordinates that are differenced and moved in each step; all if there are fewer"
    )
    delta: Step | Literal["measured"] | dict[str, Step] = Field(
        "measured",
        description="half-step of the central difference, in the group's units: one value, or one for each group",
    )
    learning_rate: Rate | dict[str, Rate] = Field(
        2e-3,
        description="Adam's learning rate, in the group's units: one value, or one for each group; default through a "
        "renderer without gradients: 10 times the step that it suggests for each group",
    )
    weight: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = Field(
        0.1,
        description="λ: weight of the summed squares of the image's change; default through a renderer without "
        "gradients: 0.001",
    )
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        None, description="U, as for fgsm; null: no limit, as in the paper, which keeps changes small by λ alone"
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

    @model_validator(mode="after")
    def _a_value_for_each_group(self) -> Self:
        for name, value in (("delta", self.delta), ("learning_rate", self.learning_rate)):
            if isinstance(value, dict):
                self.check_groups(name, value)
        return self


@register(Zoo)
class ZooMethod:
    """Each step estimates the gradient at random coordinates and moves only those, each with an Adam state of its own.

    A coordinate whose difference is below the noise does not move and keeps its Adam state; such differences are
    counted. Inactive coordinates, which provably change no pixel, are never drawn. They are found at the start and
    examined again at each step.
    """

    needs_gradient = False

    def __init__(self, settings: Zoo, problem: AttackProblem) -> None:
        self.settings = settings
        self.layout = problem.layout
        self.delta = self.layout.flatten(problem.beginning).float()
        """The perturbation as one vector [total]."""
        self.first = self.layout.zeros().double()
        self.second = self.layout.zeros().double()
        self.moves = self.layout.zeros().long()
        self.half_steps = self.layout.zeros().double()
        self.inactive = self.layout.zeros().bool()
        self.noise = 0.0

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group."""
        return self.layout.unflatten(self.delta)

    def start(self, problem: AttackProblem) -> dict[str, object]:
        """Measures the objective's noise floor and, for `delta: "measured"`, each group's half-step; finds inactive
        coordinates. Returns them as `noise`, `delta` and `skipped`.
        """
        from services.attacks.differences import inactive, measure_half_steps, measure_noise

        self.noise = measure_noise(problem, self.delta)
        asked = self.settings.delta
        if isinstance(asked, str):
            chosen = measure_half_steps(problem, REACH * self._rates(), self.noise)
        else:
            chosen = asked if isinstance(asked, dict) else dict.fromkeys(self.layout.groups, asked)
        self.half_steps = self.layout.spread(chosen)
        found = inactive(problem, self.perturbation, self.half_steps)
        self.inactive = self._mask(found)
        skipped = [{"coordinate": one.name, "why": one.why} for one in found]
        return {"delta": chosen, "noise": self.noise, "skipped": skipped}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Moves the coordinates whose difference is above the noise, by Adam. Returns the number of the others.

        Raises JobFailure("non-finite").
        """
        from services.attacks.differences import clamped, estimate
        from services.attacks.seeds import draw

        self.delta = self.layout.flatten(view.perturbation).to(self.delta.dtype)  # backtracking may have shortened it
        chosen = draw(self._active(problem), self.settings.coordinates, problem.seed, "zoo", step)
        found = estimate(problem, self.delta, chosen, self.half_steps[chosen], self.noise)
        if not bool(found.gradients.isfinite().all()):
            raise JobFailure("non-finite", "a difference of the objective is not finite")
        moving, gradients = chosen[~found.below_noise], found.gradients[~found.below_noise]
        self.moves[moving] += 1
        self.first[moving] = BETAS[0] * self.first[moving] + (1 - BETAS[0]) * gradients
        self.second[moving] = BETAS[1] * self.second[moving] + (1 - BETAS[1]) * gradients.square()
        first = self.first[moving] / (1 - BETAS[0] ** self.moves[moving].double())
        second = self.second[moving] / (1 - BETAS[1] ** self.moves[moving].double())
        rates = self._rates()[moving]
        self.delta[moving] -= (rates * first / (second.sqrt() + EPSILON)).to(self.delta.dtype)
        self.delta = clamped(problem, self.delta[None])[0]
        return int(found.below_noise.sum())

    def state(self) -> dict[str, Tensor]:
        """The perturbation, Adam's moments and counts, half-steps, the mask of inactive coordinates, and the noise."""
        return {
            "delta": self.delta,
            "first": self.first,
            "second": self.second,
            "moves": self.moves,
            "half_steps": self.half_steps,
            "inactive": self.inactive,
            "noise": self.first.new_tensor(self.noise),
        }

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.delta, self.first, self.second = state["delta"], state["first"], state["second"]
        self.moves, self.half_steps, self.noise = state["moves"], state["half_steps"], float(state["noise"])
        self.inactive = state["inactive"]

    def _mask(self, found: Sequence[InactiveCoordinate]) -> Tensor:
        return self.layout.mask((one.group, one.index) for one in found)

    def _active(self, problem: AttackProblem) -> Tensor:
        """The coordinates to draw from: all but those that the constraint fixes, and those inactive at the start that
        still are. Most scenes have none.
        """
        from services.attacks.differences import inactive
        from services.attacks.limits import fixed

        still = self.inactive
        if still.any():
            still = still & self._mask(inactive(problem, self.perturbation, self.half_steps))
        return (~(still | fixed(problem.constraint, self.layout))).nonzero()[:, 0]

    def _rates(self) -> Tensor:
        rate = self.settings.learning_rate
        return self.layout.spread(rate if isinstance(rate, dict) else dict.fromkeys(self.layout.groups, rate))
