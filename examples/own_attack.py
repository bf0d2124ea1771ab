"""An attack of one's own: random search for the pixels, which keeps a move that lowers the objective."""

from typing import Any, ClassVar, Literal

import scene_attack as sa
from scene_attack.plugin import register_attack


@register_attack
class RandomSearch(sa.Attack):
    """Random search by Gaussian moves."""

    method: Literal["random-search"] = "random-search"
    needs_gradient: ClassVar[bool] = False

    def init(self, problem: Any) -> Any:
        """The start and its objective."""
        return {"delta": problem.start, "objective": problem.objectives(problem.start[None])[0]}

    def step(self, problem: Any, state: Any, evaluation: Any) -> Any:
        """Tries one move."""
        move = problem.start.clone().normal_(0, 0.01, generator=problem.generator("moves", evaluation.step))
        tried = problem.limits.clamp(state["delta"] + move)
        [objective] = problem.objectives(tried[None], evaluation.step)
        return {"delta": tried, "objective": objective} if objective < state["objective"] else state


scene = sa.Scene(objects=[sa.Object(mesh="primitive/torus")], camera=sa.Camera(size=(64, 64)))
result = sa.attack(scene, "efficientnet-lite0", RandomSearch(renderer="image", steps=40))
print(f"{result.outcome}: the objective fell from {result.trace[0].objective:.3f} to {result.trace[-1].objective:.3f}")
