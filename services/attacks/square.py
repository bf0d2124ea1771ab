"""Square Attack (Andriushchenko et al. 2020): random squares of ±ε, each kept if it lowers the objective."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from services.attacks.attack import AttackSettings, register, renderer_names, suggested_limits
from services.attacks.losses import DESCRIPTION, Loss
from services.rendering.declaration import RENDERERS

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.problem import AttackProblem, Evaluation
    from services.rendering.protocol import Parameters

HALVED_AFTER = (10, 50, 200, 500, 1000, 2000, 4000, 6000, 8000)
"""Steps of a run of 10,000 after which the share of the pixels in a square is halved; shorter runs are scaled."""


class Square(AttackSettings):
    """Square Attack (Andriushchenko et al. 2020): a square at a random place is set to ±ε in each channel, and kept if
    the objective falls. It needs scores only, one query a step. Where it succeeds and gradient methods hold, the
    network's gradient misleads them.
    """

    method: Literal["square"] = "square"
    renderer: str = Field(
        "image", description="the renderer whose parameters are attacked", json_schema_extra=renderer_names
    )
    steps: Annotated[int, Field(ge=1, le=100_000)] = Field(
        1000, description="largest number of steps, over which the squares become smaller"
    )
    share: Annotated[float, Field(gt=0, le=1)] = Field(0.8, description="share of the pixels in the first squares")
    loss: Loss = Field("margin", description=DESCRIPTION)

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


def groups_without_pixels(settings: AttackSettings) -> list[str]:
    """The attacked groups that have no values by pixel, in which there are no squares."""
    declared = RENDERERS[settings.renderer]
    return [group for group in settings.groups if declared.group(group).shape[:2] != ("H", "W")]


@register(Square)
class SquareMethod:
    """The perturbation is the one to try; its evaluation by the loop is the only query of a step.

    The first is of vertical stripes of ±ε, and is kept whatever its objective.
    """

    needs_gradient = False

    def __init__(self, settings: Square, problem: AttackProblem) -> None:
        import torch

        self.settings = settings
        self.tried: Parameters = problem.beginning
        self.best: Parameters = problem.beginning
        self.best_objective = torch.tensor(torch.inf, dtype=torch.float64)

    @property
    def perturbation(self) -> Parameters:
        """The perturbation to try, by group."""
        return self.tried

    def start(self, problem: AttackProblem) -> dict[str, object]:  # noqa: ARG002 - nothing to measure
        """Square measures no settings."""
        return {}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """Keeps what was tried if it is better, and draws the next. Returns 0: no difference is taken."""
        from services.attacks.seeds import generator

        random = generator(problem.seed, "square", step)
        if step == 0:
            self.tried = problem.clamp({g: self._stripes(g, v, random) for g, v in self.best.items()})
            return 0
        if step == 1 or view.objective < float(self.best_objective):
            self.best = view.perturbation
            self.best_objective = self.best_objective.new_tensor(view.objective)
        side = square_side(self.settings.share, step - 1, self.settings.steps, problem.renderer.size)
        self.tried = problem.clamp({g: self._with_square(g, v, side, random) for g, v in self.best.items()})
        return 0

    def state(self) -> dict[str, Tensor]:
        """The best perturbation, its objective, and the one to try."""
        named = {f"best.{g}": v for g, v in self.best.items()} | {f"tried.{g}": v for g, v in self.tried.items()}
        return named | {"best_objective": self.best_objective}

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.best = {g: state[f"best.{g}"] for g in self.best}
        self.tried = {g: state[f"tried.{g}"] for g in self.tried}
        self.best_objective = state["best_objective"]

    def _stripes(self, group: str, value: Tensor, random: Any) -> Tensor:
        return _signs((1, *value.shape[1:]), random).to(value.dtype).expand_as(value) * self.settings.epsilon[group]

    def _with_square(self, group: str, value: Tensor, side: int, random: Any) -> Tensor:
        """The group's perturbation [H, W, …] with a square of random place moved by ±2ε, which clamping makes ±ε."""
        import torch

        height, width, *channels = value.shape
        top, left = (int(torch.randint(0, n - side + 1, (), generator=random)) for n in (height, width))
        moved = value.clone()
        change = 2 * self.settings.epsilon[group] * _signs((1, 1, *channels), random).to(value.dtype)
        moved[top : top + side, left : left + side] += change
        return moved


def square_side(share: float, step: int, steps: int, size: tuple[int, int]) -> int:
    """Side of the square of step `step` (from 0) of `steps`, pixels, in an image of `size` (height, width)."""
    halvings = sum(step * 10_000 // steps > after for after in HALVED_AFTER)
    side = round(sqrt(share / 2**halvings * size[0] * size[1]))
    return min(max(side, 1), *size)


def _signs(shape: tuple[int, ...], random: Any) -> Tensor:
    """Random values of ±1 in float64."""
    import torch

    return 2.0 * torch.randint(0, 2, shape, generator=random).double() - 1.0
