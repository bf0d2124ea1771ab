"""A renderer and a network small enough to know everything about: both linear, in float64 if asked."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from scene_attack.attacks.attack import Attack, State
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem, Evaluation, differentiate, evaluate
from scene_attack.attacks.run import AttackRun, Verifier, run_attack
from scene_attack.errors import Cancelled
from scene_attack.rendering.plan import ImageError, Plan
from scene_attack.rendering.sensor.settings import SensorRange

STILL = dict.fromkeys(("exposure", "white_balance", "defocus", "motion", "iso", "sharpening"), 0.0)
NOISY = SensorRange.model_validate({**STILL, "resolution": 1.0, "quality": 100, "iso": 102_400})
"""Cameras whose only fault is noise, in the middle of the range of about 8/255 of each displayed value."""


@dataclass
class LinearRenderer:
    """image = base + A·a + B·b, clipped to [0,1]. `eight_bits` rounds it, as stock pyrender does."""

    dtype: torch.dtype = torch.float64
    eight_bits: bool = False
    seed: int = 0

    name = "torch"
    groups = ("a", "b")
    differentiable = True
    backend = "linear"
    size = (4, 5)
    plan = Plan.of("torch", groups, size, "exact", [])
    sampled_error: ClassVar[ImageError | None] = None

    def __post_init__(self) -> None:
        random = torch.Generator().manual_seed(self.seed)
        self.base = 0.5 + 0.1 * torch.randn(4, 5, 3, generator=random, dtype=torch.float64).clamp(-2, 2)
        self.weights = {
            "a": 0.2 * torch.randn(60, 6, generator=random, dtype=torch.float64),
            "b": 0.2 * torch.randn(60, 3, generator=random, dtype=torch.float64),
        }

    def initial(self) -> dict[str, Tensor]:
        return {"a": torch.zeros(2, 3, dtype=self.dtype), "b": torch.zeros(3, dtype=self.dtype)}

    def bounds(self) -> dict[str, tuple[Tensor, Tensor]]:
        return {"a": (torch.tensor(-torch.inf), torch.tensor(torch.inf)), "b": (torch.tensor(0.0), torch.tensor(1.0))}

    def names(self, group: str) -> None:
        return None

    def inactive(self, parameters: Mapping[str, Tensor], reach: Mapping[str, float]) -> tuple[()]:
        return ()

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        image = self.base.to(self.dtype).flatten()[None]
        for group, value in parameters.items():
            image = image + value.flatten(1) @ self.weights[group].to(self.dtype).T
        image = image.clamp(0, 1)
        if self.eight_bits:
            image = (image * 255).round() / 255
        return image.reshape(-1, 4, 5, 3)

    def exact(self) -> "LinearRenderer":
        return self

    def reseeded(self, number: int) -> None:
        return None


class CurvedRenderer(LinearRenderer):
    """A smooth, curved function of its parameters, within [0,1] wherever they are."""

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        value = self.base.to(self.dtype).flatten()[None]
        for group, moved in parameters.items():
            value = value + moved.flatten(1) @ self.weights[group].to(self.dtype).T
        return (0.5 + 0.4 * torch.sin(3 * value)).reshape(-1, 4, 5, 3)


class OpaqueCurvedRenderer(CurvedRenderer):
    """The same without gradients."""

    differentiable = False

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        return super().render({group: value.detach() for group, value in parameters.items()}).detach()


class FreeRenderer(LinearRenderer):
    """The same without bounds, so that every coordinate can move either way."""

    def bounds(self) -> dict[str, tuple[Tensor, Tensor]]:
        free = torch.tensor(torch.inf)
        return {"a": (-free, free), "b": (-free, free)}


@dataclass
class LinearTarget:
    """logits = scale·W·pixels."""

    scale: float = 3.0
    classes: int = 4
    dtype: torch.dtype = torch.float64

    name = "linear"
    input_size = (4, 5)
    differentiable = True
    weights_sha256 = "0" * 64
    backend = "linear"

    def __post_init__(self) -> None:
        self.labels = tuple(f"label {k}" for k in range(self.classes))
        random = torch.Generator().manual_seed(1)
        self.weights = torch.randn(60, self.classes, generator=random, dtype=torch.float64)

    def logits(self, images: Tensor) -> Tensor:
        return self.scale * (images.to(self.dtype).flatten(1) - 0.5) @ self.weights.to(self.dtype)


LIMITS = ("bounds", "epsilon", "constraint", "truncation", "backtrack", "perceptibility")


def problem(
    renderer: LinearRenderer | None = None, target: LinearTarget | None = None, **settings: Any
) -> AttackProblem:
    """The linear problem of leaving the first answer, with all groups attacked."""
    renderer, target = renderer or LinearRenderer(), target or LinearTarget()
    start = {g: v[None] for g, v in renderer.initial().items()}
    first = int(target.logits(renderer.render(start)).argmax())
    given = {name: settings.pop(name) for name in LIMITS if name in settings}
    limits = Limits.of(renderer, renderer.groups, **given)
    return AttackProblem.of(renderer, target, ResolvedGoal((first,), None), limits, **settings)


def attack(case: AttackProblem, settings: Attack, checkpoint: Path | None = None, **given: object) -> AttackRun:
    """Runs an attack with these settings, changed by `given`, to its end."""
    return run_attack(AttackRun.begin_or_resume(case, settings.model_copy(update=given), Verifier.of(case), checkpoint))


def resumed(
    make: Callable[[], AttackProblem], settings: Attack, path: Path, renders: int | None = None, **given: object
) -> AttackRun:
    """An attack that was cancelled and went on from its checkpoint `path`, which was saved after every step. It is
    asserted to end as one that ran through.

    It is cancelled after `renders` calls of the problem's `interrupt`, by default half of all. `make` makes a problem.
    """
    calls = 0

    def count() -> None:
        nonlocal calls
        calls += 1

    whole = attack(replace(make(), interrupt=count), settings, **given)
    left = iter(range(calls // 2 if renders is None else renders))

    def die() -> None:
        if next(left, None) is None:
            raise Cancelled

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scene_attack.attacks.run.CHECKPOINT_SECONDS", -1.0)
        with pytest.raises(Cancelled):
            attack(replace(make(), interrupt=die), settings, path, **given)
    assert path.exists()
    found = attack(make(), settings, path, **given)
    ours, theirs = ([row.model_copy(update={"seconds": 0}) for row in one.trace] for one in (whole, found))
    assert ours == theirs
    for group, value in whole.stored.items():
        assert torch.equal(value, found.stored[group])
    assert torch.equal(whole.state["delta"], found.state["delta"])
    assert torch.equal(whole.ever_truncated, found.ever_truncated)
    assert (whole.settings, whole.sampled_error) == (found.settings, found.sampled_error)
    return found


def guided(case: AttackProblem, delta: Tensor, step: int = 0) -> Evaluation:
    """The evaluation of a perturbation [total] with the objective and its gradient, as the loop hands it to attacks."""
    found = differentiate(case, evaluate(case, delta, step, gradient=True))
    return replace(found, objective=float(case.objective(found.answers).mean()))


def stepped(case: AttackProblem, settings: Attack, state: State, step: int) -> State:
    """The state after one step of an attack, as the loop takes it."""
    if settings.needs_gradient:
        return settings.step(case, state, guided(case, state["delta"], step))
    looked = evaluate(case, state["delta"], step)
    return settings.step(case, state, replace(looked, objective=float(case.objective(looked.answers).mean())))


class Pixels(LinearRenderer):
    """One group, `image`: the 4×5 pixels themselves, which are multiples of 1/255."""

    groups = ("image",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.base = (self.base * 255).round() / 255

    def initial(self) -> dict[str, Tensor]:
        return {"image": self.base.to(self.dtype)}

    def bounds(self) -> dict[str, tuple[Tensor, Tensor]]:
        return {"image": (torch.tensor(0.0), torch.tensor(1.0))}

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        return parameters["image"].clamp(0, 1)


class Ahead(LinearTarget):
    """Its answer to the renderer's original leads by 10, so that no small perturbation ends an attack early."""

    def __init__(self, renderer: LinearRenderer, scale: float = 0.02, classes: int = 4) -> None:
        super().__init__(scale=scale, classes=classes)
        self.lead = torch.zeros(classes)
        original = renderer.render({group: value[None] for group, value in renderer.initial().items()})
        first = int(super().logits(original).argmax())
        self.lead[first] = 10.0

    def logits(self, images: Tensor) -> Tensor:
        return super().logits(images) + self.lead


class Bowl(LinearTarget):
    """Two classes, of which the first leads by the squared distance of the image from `bottom` [H, W, 3]."""

    def __init__(self, bottom: Tensor, scale: float = 1.0) -> None:
        super().__init__(scale=scale, classes=2)
        self.bottom = bottom

    def logits(self, images: Tensor) -> Tensor:
        leads = self.scale * (images.to(self.dtype) - self.bottom).square().flatten(1).sum(dim=1)
        return torch.stack([leads, torch.zeros_like(leads)], dim=1)


def smooth() -> AttackProblem:
    """A quadratic objective of 9 parameters, for which central differences have no error of their own."""
    renderer = FreeRenderer()
    bottom = {"a": torch.full((1, 2, 3), 0.2, dtype=torch.float64), "b": torch.full((1, 3), -0.1, dtype=torch.float64)}
    return problem(renderer, Bowl(renderer.render(bottom)[0]))


def autograd(case: AttackProblem, at: torch.Tensor) -> torch.Tensor:
    """The gradient of the advantage + λ‖ΔY‖² at a perturbation [total], by autograd through the renderer."""
    leaf = at.clone().requires_grad_()
    images = case.renderer.render(case.layout.unflatten((case.initial + leaf)[None]))
    value = case.goal.advantage(case.target.logits(images)).sum()
    value = value + case.distance_weight * (images - case.original).square().sum()
    return torch.autograd.grad(value, leaf)[0]
