"""Steps of an attack that are far too large, or lead nowhere."""

from functools import partial
from typing import Any

import numpy as np
import torch

from services.accuracy.placing import placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.linear import linear_problem, pixels
from services.accuracy.stability.shading import SHARP, Shading
from services.attacks.fgsm import Fgsm, FgsmMethod
from services.attacks.problem import truncate
from services.attacks.run import AttackState, Budget, Verifier, run
from services.attacks.zoo import Zoo, ZooMethod
from services.rendering.factory import build
from services.rendering.protocol import Parameters, Renderer

DEFINED = "largest error of a displayed value, against the definition in float64"


def _fgsm(renderer: Renderer, group: str, steps: int, **settings: Any) -> tuple[AttackState, Parameters]:
    """The attack after all its steps, and its last perturbation, which need not be the one that it stored."""
    problem = linear_problem(renderer, (group,))
    spec = Fgsm.model_validate({"renderer": renderer.name, "groups": (group,), "truncation": None} | settings)
    method = FgsmMethod(spec, problem)
    found = run(problem, method, Verifier(renderer, problem.target), Budget(steps))
    need(found.step == steps, f"it stopped after {found.step} steps")
    need(all(np.isfinite(row.perceptibility) for row in found.trace), "a perceptibility is not finite")
    return found, method.perturbation


def _no_step(renderer: Renderer, group: str) -> Measured:
    """η = 0 moves nothing, however often."""
    found, last = _fgsm(renderer, group, 120, learning_rate={group: 0.0})
    need(not bool(last[group].any()), "the perturbation is not zero")
    # Images with a gradient may be computed in another order than the original, to float32's rounding.
    moved = max(row.perceptibility for row in found.trace)
    need(len({row.perceptibility for row in found.trace}) == 1, "the image changes from step to step")
    return Measured(moved, 2e-7, "largest perceptibility in 120 steps, all alike; the perturbation is exactly 0")


def _giant_step(group: str) -> Measured:
    """η = 1e3: the parameters stay within bounds, and images of them are those of the definition."""
    shading = Shading.of(placed(radiance=sky(), size=(16, 16)))
    renderer = shading.renderer
    _, last = _fgsm(renderer, group, 120, learning_rate={group: 1e3})
    low, high = renderer.bounds()[group]
    value = renderer.initial()[group] + last[group]
    need(bool(torch.isfinite(value).all()), "a parameter is not finite")
    need(float(last[group].abs().max()) > 1.0, "it does not move")
    rounding = 1e-6 * (1 + value.abs())
    need(bool((value >= low - rounding).all() and (value <= high + rounding).all()), "a parameter is out of bounds")
    return shading.errors({group: value}).within(SHARP, DEFINED)


def _far_angles() -> Measured:
    """The furthest that 120 steps of η = 1e3 can go: normals moved by a million radians, in any direction."""
    shading = Shading.of(placed(radiance=sky(), size=(16, 16)))
    renderer = shading.renderer
    problem = linear_problem(renderer, ("normals",))
    shape = renderer.initial()["normals"].shape
    moved = 2e6 * torch.rand(shape, generator=torch.Generator().manual_seed(9)) - 1e6
    value = renderer.initial()["normals"] + problem.clamp({"normals": moved})["normals"]
    with torch.no_grad():
        seen = renderer.render({"normals": value[None]})[0]
    need(float((seen - problem.original[0]).abs().max()) > 0.01, "it does not move")
    need(float(value.abs().max()) < 1000, "float32 does not tell such angles apart")
    return shading.errors({"normals": value}).within(SHARP, DEFINED)


def _giant_zoo() -> Measured:
    """η = 1e3 through pyrender: out of the image and beyond every light, within bounds and finite."""
    renderer = build(placed(size=(16, 16)), "pyrender")
    problem = linear_problem(renderer)
    method = ZooMethod(Zoo(method="zoo", renderer="pyrender", delta=1e-2, learning_rate=1e3, steps=20), problem)
    found = run(problem, method, Verifier(renderer, problem.target), Budget(20))
    outside = 0.0
    for group in problem.groups:
        low, high = renderer.bounds()[group]
        value = renderer.initial()[group] + method.perturbation[group]
        need(bool(torch.isfinite(value).all()), f"{group} is not finite")
        outside = max(outside, float((low - value).clamp_min(0).max()), float((value - high).clamp_min(0).max()))
    need(max(float(v.abs().max()) for v in method.perturbation.values()) > 100, "it does not move")
    need(all(np.isfinite(row.perceptibility) for row in found.trace), "a perceptibility is not finite")
    return Measured(outside, 1e-6, "how far any parameter is out of its bounds after 20 steps")


def _giant_decay() -> Measured:
    """η = 1e3 and decay 1 would multiply the perturbation by 1,000 a step; pixels are held in [0,1]."""
    renderer = pixels()
    _, last = _fgsm(renderer, "image", 120, learning_rate={"image": 1e3}, weight_decay=1.0)
    shown = renderer.initial()["image"] + last["image"]
    need(bool(torch.isfinite(shown).all()), "a pixel is not finite")
    return Measured(float(torch.maximum(-shown, shown - 1).max()), 1e-7, "how far any pixel is out of [0,1]")


def _no_gradient() -> Measured:
    """A black object shows no light, material or normals: 120 steps with zero gradients, all reported flat."""
    renderer = build(placed(thing={"color": (0, 0, 0)}, size=(16, 16)), "torch")
    problem = linear_problem(renderer)
    method = FgsmMethod(Fgsm(groups=renderer.plan.groups), problem)
    found = run(problem, method, Verifier(renderer, problem.target), Budget(120))
    reported = [row.below_noise for row in found.trace]
    need(reported == [0] + [3] * 120, "not all three groups are reported flat at every step")
    need(found.stopped == "steps", f"it stopped for {found.stopped}")
    moved = max(float(v.abs().max()) for v in found.stored.values())
    return Measured(moved, 0.0, "largest perturbation; three of three groups reported flat, 120 times")


def _coasting() -> Measured:
    """Momentum over 120 steps with zero gradients, after one push: a closed form, the power of a 2×2 matrix."""
    renderer = build(placed(thing={"color": (0, 0, 0)}, size=(16, 16)), "torch")
    problem = linear_problem(renderer, ("illumination",))
    rate, momentum, decay = 3e-3, 0.9, 1e-2
    settings = {"groups": ("illumination",), "learning_rate": {"illumination": rate}, "weight_decay": decay}
    method = FgsmMethod(Fgsm.model_validate(settings), problem)
    state = method.state()
    state["velocity.illumination"] = torch.full_like(state["velocity.illumination"], -1.0)
    method.load(state)
    found = run(problem, method, Verifier(renderer, problem.target), Budget(120))
    # (Δ, v) → v' = momentum·v + decay·Δ, Δ' = Δ − rate·v'
    step = np.array([[1 - rate * decay, -rate * momentum], [decay, momentum]])
    wanted = float((np.linalg.matrix_power(step, 120) @ np.array([0.0, -1.0]))[0])
    need(found.step == 120, f"it stopped after {found.step} steps")
    error = (found.stored["illumination"].double() - wanted).abs().max()
    return Measured(float(error) / wanted, 1e-5, "relative error of the perturbation, closed form")


def _at_the_limit() -> Measured:
    """U: a value moved by exactly 18/255 is not beyond it, one moved by a hundredth of a step more is held there."""
    original = (torch.arange(0, 237).repeat_interleave(3).reshape(1, 1, 237, 3) / 255).float()
    limit = 18 / 255
    at, held_at = truncate(original + torch.tensor(18.0) / 255, original, limit)
    beyond, held_beyond = truncate(original + 18.01 / 255, original, limit)
    need(int(held_at.sum()) == 0, f"{int(held_at.sum())} of 237 pixels at the limit are held")
    need(int(held_beyond.sum()) == 237, f"{237 - int(held_beyond.sum())} of 237 pixels beyond the limit are not held")
    need(bool((at >= original).all()), "a pixel went the wrong way")
    return Measured(float((beyond - original - limit).abs().max()), 1e-7, "distance of a held value from the limit")


def cases() -> list[Case]:
    """The cases of this family."""
    family = "steps"
    return [
        Case("η = 0, pixels", family, "no step", "nothing moves", lambda: _no_step(pixels(), "image")),
        Case(
            "η = 0, torch",
            family,
            "no step",
            "nothing moves",
            lambda: _no_step(build(placed(size=(16, 16)), "torch"), "material"),
        ),
        *(
            Case(
                f"η = 1e3, {group}",
                family,
                "120 steps of 1,000 and more",
                "in bounds, and images by the definition",
                partial(_giant_step, group),
                "clipped",
            )
            for group in ("normals", "illumination", "material")
        ),
        Case(
            "normals + 1e6",
            family,
            "float32 has 0.06 radians left there",
            "held where it has 1e-5, and the definition's image",
            _far_angles,
            "clipped",
        ),
        Case("η = 1e3, pyrender", family, "20 steps of 1,000", "in bounds and finite", _giant_zoo, "clipped"),
        Case("η = 1e3, decay 1", family, "×1,000 a step", "in bounds", _giant_decay, "clipped"),
        Case(
            "no gradient, 120 steps",
            family,
            "a black object",
            "stays, and every step is reported flat",
            _no_gradient,
            "flat",
        ),
        Case("momentum, no gradient", family, "120 steps after one push", "the closed form", _coasting),
        Case(
            "moved by exactly U",
            family,
            "a comparison of equals",
            "18/255 is not beyond 18/255",
            _at_the_limit,
            "clipped",
        ),
    ]
