"""Square Attack (Andriushchenko et al. 2020): random squares of ±ε, each kept if it lowers the objective."""

from __future__ import annotations

from math import inf, sqrt
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scene_attack.attacks.attack import Attack, register, renderer_names, suggested_limits
from scene_attack.attacks.request import LOSS_DESCRIPTION, Loss
from scene_attack.rendering.declaration import RENDERERS

if TYPE_CHECKING:
    from torch import Generator, Tensor

    from scene_attack.attacks.attack import State
    from scene_attack.attacks.problem import AttackProblem, Evaluation

HALVED_AFTER = (10, 50, 200, 500, 1000, 2000, 4000, 6000, 8000)
"""Steps of a run of 10,000 after which the share of the pixels in a square is halved; shorter runs are scaled."""


@register
class Square(Attack):
    """Square Attack (Andriushchenko et al. 2020): a square at a random place is set to ±ε in each channel, and kept if
    the objective falls. It needs scores only, one query a step. Where it succeeds and gradient methods hold, the
    network's gradient misleads them.
    """

    method: Literal["square"] = "square"
    needs_gradient: ClassVar[bool] = False
    renderer: str = Field(
        default="image", description="the renderer whose parameters are attacked", json_schema_extra=renderer_names
    )
    steps: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=1000, description="largest number of steps, over which the squares become smaller"
    )
    share: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.8, description="share of the pixels in the first squares"
    )
    loss: Loss = Field(default="margin", description=LOSS_DESCRIPTION)

    @property
    def objective(self) -> Loss:
        """The loss that the method compares."""
        return self.loss

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the limits that the renderer suggests for its groups."""
        return suggested_limits(data)

    @model_validator(mode="after")
    def _images_with_a_limit(self) -> Self:
        for group in groups_without_pixels(self):
            raise ValueError(f"groups: {group!r} is no image; square needs a value or more at each pixel")
        self.check_groups("epsilon", self.epsilon)
        return self

    def init(self, problem: AttackProblem) -> State:
        """Nothing is kept yet."""
        return {"delta": problem.start, "best": problem.start, "objective": problem.start.double().new_tensor(inf)}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        """Keeps what was tried if it is better, and draws the next; its evaluation by the loop is the only query.

        The first is of vertical stripes of ±ε, and is kept whatever its objective.
        """
        random, step = problem.generator("square", evaluation.step), evaluation.step
        best, objective = state["best"], state["objective"]
        if step == 1 or (step and evaluation.objective < float(objective)):
            best, objective = evaluation.delta, objective.new_tensor(evaluation.objective)
        side = square_side(self.share, step - 1, self.steps, problem.renderer.size)
        tried = {}
        for group, value in problem.layout.unflatten(best).items():
            epsilon = self.epsilon[group]
            tried[group] = with_square(value, epsilon, side, random) if step else stripes(value, epsilon, random)
        delta = problem.limits.clamp(problem.layout.flatten(tried))
        return {"delta": delta, "best": best, "objective": objective}


def groups_without_pixels(settings: Attack) -> list[str]:
    """The attacked groups that have no values by pixel, in which there are no squares."""
    declared = RENDERERS[settings.renderer]
    return [group for group in settings.groups if declared.group(group).shape[:2] != ("H", "W")]


def square_side(share: float, step: int, steps: int, size: tuple[int, int]) -> int:
    """Side of the square of step `step` (from 0) of `steps`, pixels, in an image of `size` (height, width)."""
    halvings = sum(step * 10_000 // steps > after for after in HALVED_AFTER)
    side = round(sqrt(share / 2**halvings * size[0] * size[1]))
    return min(max(side, 1), *size)


def stripes(value: Tensor, epsilon: float, random: Generator) -> Tensor:
    """Vertical stripes of ±ε, of the shape [H, W, …] of a group's value."""
    return _signs((1, *value.shape[1:]), random).to(value.dtype).expand_as(value) * epsilon


def with_square(value: Tensor, epsilon: float, side: int, random: Generator) -> Tensor:
    """A group's perturbation [H, W, …] with a square of random place moved by ±2ε, which clamping makes ±ε."""
    import torch

    height, width, *channels = value.shape
    top, left = (int(torch.randint(0, n - side + 1, (), generator=random)) for n in (height, width))
    moved = value.clone()
    moved[top : top + side, left : left + side] += 2 * epsilon * _signs((1, 1, *channels), random).to(value.dtype)
    return moved


def _signs(shape: tuple[int, ...], random: Generator) -> Tensor:
    """Random values of ±1 in float64."""
    import torch

    return 2.0 * torch.randint(0, 2, shape, generator=random).double() - 1.0
