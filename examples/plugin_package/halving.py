"""A plug-in: a random search whose moves become smaller by half after each move that did not help.

`pip install ./examples/plugin_package` installs it, and `scene-attack doctor` then lists it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from scene_attack.plugin import Attack, register_attack

if TYPE_CHECKING:
    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

INTERFACE = 1


@register_attack
class Halving(Attack):
    """Random search: a move that lowers the objective is kept, and halves the next moves if it does not."""

    method: Literal["halving"] = "halving"
    needs_gradient: ClassVar[bool] = False
    spread: Annotated[float, Field(gt=0, le=1)] = Field(default=0.1, description="standard deviation of the first move")

    def init(self, problem: AttackProblem) -> State:
        """The start, its objective, and the size of a move."""
        [objective] = problem.objectives(problem.start[None])
        return {"delta": problem.start, "objective": objective, "spread": objective.new_tensor(self.spread)}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """Tries one move."""
        move = problem.start.clone().normal_(generator=problem.generator("halving", evaluation.step))
        tried = problem.limits.clamp(state["delta"] + state["spread"] * move)
        [objective] = problem.objectives(tried[None], evaluation.step)
        if objective < state["objective"]:
            return state | {"delta": tried, "objective": objective}
        return state | {"spread": state["spread"] / 2}
