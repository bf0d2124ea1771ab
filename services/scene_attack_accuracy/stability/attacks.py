"""Attacks whose every step is known, on a linear network: the recurrences written down again in numpy; steps that are
far too large, or lead nowhere; differences over steps that are far too small, or far too large.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scene_attack.attacks.differences import CANDIDATES, estimate, measure_noise
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.limits import truncate
from scene_attack.attacks.problem import evaluate
from scene_attack.attacks.run import AttackRun, Verifier, run_attack
from scene_attack.attacks.zoo import ZOO
from scene_attack.rendering.factory import build
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.scenes.mesh import Doubles
from scene_attack_accuracy.placing import placed, sky
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.objects import SIDE, attacked, linear_gradient, linear_problem, pixels
from scene_attack_accuracy.stability.torch_shading import SHARP, Shading

LIMIT = 18 / 255
"""Bound U of the paper on the change of a pixel's value."""

FLOAT32 = 1e-6
"""Rounding of a perturbation below 1 after some tens of float32 sums."""


def _start() -> Doubles:
    return pixels().initial()["image"].double().numpy()


def _pixel_fgsm(steps: int, rate: float, begin: Doubles | None = None, **settings: Any) -> AttackRun:
    """FGSM on the pixels for some steps, from the perturbation `begin` if there is one."""
    fields = {"renderer": "image", "learning_rate": {"image": rate}, "truncation": None, "steps": steps} | settings
    attack = FGSM.model_validate(fields)
    limit = None if attack.truncation is None else attack.truncation / 255
    delta = None if begin is None else torch.from_numpy(begin).float().flatten()
    return attacked(linear_problem(pixels(), truncation=limit), attack, delta)


def _momentum(steps: int, rate: float, momentum: float, decay: float, bounded: bool) -> Measured:
    """v ← μ v + sign(w) + decay Δ, Δ ← Δ − η v, held so that pixels stay in [0,1]; w is the network's own gradient."""
    run = _pixel_fgsm(steps, rate, momentum=momentum, weight_decay=decay)
    start, sign = _start(), np.sign(linear_gradient().numpy())
    delta, velocity = np.zeros_like(start), np.zeros_like(start)
    for _ in range(steps):
        velocity = momentum * velocity + sign + decay * delta
        delta = np.clip(delta - rate * velocity, -start, 1 - start)
    at_bounds = (start + delta == 0) | (start + delta == 1)
    need(bounded == bool(at_bounds.any()), "bounds are met where they should not be")
    error = np.abs(run.stored["image"].double().numpy() - delta).max()
    velocities = run.problem.layout.unflatten(run.state["velocity"])["image"].double().numpy()
    velocity_error = np.abs(velocities - velocity).max() / np.abs(velocity).max()
    return Measured(max(float(error), float(velocity_error)), FLOAT32, "error of the perturbation and of the velocity")


def _held() -> Measured:
    """Steps of 0.1 are beyond U at once: nothing that is held back passes a gradient, so the first step is the last.

    The attacked image is the original ± U.
    """
    run = _pixel_fgsm(5, 0.1, momentum=0.0, weight_decay=0.0, truncation=18)
    sign = np.sign(linear_gradient().numpy())
    need([row.truncated for row in run.trace[1:]] == [64] * 5, "not all pixels are held")
    problem = linear_problem(pixels(), truncation=LIMIT)
    assert run.best is not None
    shown = evaluate(problem, run.best.delta, 0).image[0].double().numpy()
    error = np.abs(shown - (_start() - LIMIT * sign)).max()
    worst = max(float(error), largest(run.stored["image"].double().numpy() + 0.1 * sign))
    return Measured(worst, FLOAT32, "error of the perturbation, −0.1 sign(w), and of the image, original ± U")


def _partly_held() -> Measured:
    """One value of each pixel is beyond U and two are not: the step moves only those two."""
    begin = np.full_like(_start(), 0.5 * LIMIT)
    begin[..., 1] = -1.5 * LIMIT
    run = _pixel_fgsm(1, 0.01, begin, momentum=0.0, weight_decay=0.0, truncation=18)
    reference = begin - 0.01 * np.sign(linear_gradient().numpy()) * (np.abs(begin) < LIMIT)
    error = np.abs(run.stored["image"].double().numpy() - reference).max()
    return Measured(float(error), FLOAT32, "error of the perturbation")


def _with_weight(at: float, delta: float, weight: float) -> Measured:
    """The objective is linear in the pixels plus λ‖Δ‖², so that a central difference is w + 2 λ Δ whatever its step."""
    problem = linear_problem(pixels(), lead=0.0, distance_weight=weight)
    random = np.random.default_rng(6)
    where = at * random.choice([-1.0, 1.0], size=_start().size)
    start = torch.from_numpy(where).float()
    deltas = torch.full((len(where),), delta, dtype=torch.float64)
    estimated = estimate(problem, start, torch.arange(len(where)), deltas, measure_noise(problem, start))
    reference = linear_gradient().flatten().numpy() + 2 * weight * where
    error = np.abs(estimated.gradients.double().numpy() - reference).max() / np.abs(reference).max()
    # float32 scores of about 1 have 1e-6, over twice the step.
    return Measured(float(error), 1e-6 / delta, "relative error of a gradient, closed form")


def _chosen_step() -> Measured:
    """The measured difference step is one under which gradients are right to a thousandth."""
    problem = linear_problem(pixels(), lead=0.0, distance_weight=0.5)
    attack = ZOO(method="zoo", renderer="image", delta="measured", learning_rate=0.01)
    state = attack.init(problem)
    chosen = attack.measured(problem, state)["delta"]
    need(isinstance(chosen, dict) and chosen["image"] in CANDIDATES[1:-1], f"it chose {chosen}")
    deltas, noise = state["half_steps"], float(state["noise"])
    estimated = estimate(problem, torch.zeros(len(deltas)), torch.arange(len(deltas)), deltas, noise)
    reference = linear_gradient().flatten()
    error = (estimated.gradients.double() - reference).abs().max() / reference.abs().max()
    return Measured(float(error), 1e-3, "relative error of a gradient, closed form")


def _adam(steps: int, weight: float) -> Measured:
    """ZOO on all coordinates at once, against Adam (Kingma and Ba 2015, algorithm 1) on the gradient w + 2 λ Δ."""
    rate = 0.01
    problem = linear_problem(pixels(), lead=0.0, distance_weight=weight)
    attack = ZOO(method="zoo", renderer="image", delta=1e-2, learning_rate=rate, weight=weight, coordinates=192)
    state = attack.init(problem)
    w = linear_gradient().numpy().ravel()
    delta, first, second = (np.zeros_like(w) for _ in range(3))
    for step in range(1, steps + 1):
        state = attack.step(problem, state, evaluate(problem, state["delta"], step))
        below = int(state["below_noise"])
        need(below <= 2, f"{below} differences are below the noise")
        gradient = w + 2 * weight * delta
        first, second = 0.9 * first + 0.1 * gradient, 0.999 * second + 0.001 * gradient**2
        delta = delta - rate * (first / (1 - 0.9**step)) / (np.sqrt(second / (1 - 0.999**step)) + 1e-8)
    reached = state["delta"].double().numpy()
    # A difference has 1e-4, and Adam's quotient the relative error of its gradients: those that pass 0 are left out.
    large = np.abs(w) > 2.5 * weight * rate * steps + 0.01
    need(large.mean() > 0.5, f"only {large.mean():.0%} of the gradients are large")
    return Measured(float(np.abs(reached - delta)[large].max()) / rate, 1e-2, "error of the perturbation, in steps")


def recurrence_cases() -> Iterator[Case]:
    """The cases of this family."""
    recurrence = "the recurrence, written down again"
    central, beside = "w + 2 λ Δ", "a quadratic objective, away from the start"
    yield case("signs alone", "no momentum", recurrence, _momentum, 10, 1e-3, 0.0, 0.0, False)
    yield case("momentum", "10 steps of η = 1e-3", recurrence, _momentum, 10, 1e-3, 0.9, 0.0, False)
    yield case("decay", "a pull of 1", recurrence, _momentum, 10, 1e-2, 0.5, 1.0, False)
    bounds = (30, 2e-2, 0.9, 0.1, True)
    yield case("momentum against bounds", "pixels at 0 and 1", recurrence, _momentum, *bounds, held="clipped")
    yield case("all beyond U", "no gradient left", "the first step is the last", _held, held="clipped")
    yield case("a third beyond U", "gradients of two of three values", "only these move", _partly_held, held="clipped")
    for at, delta, weight in ((0.1, 0.05, 3.0), (0.1, 0.01, 0.3), (0.05, 0.1, 10.0)):
        yield case(f"difference, λ {weight:g}, δ {delta:g}", beside, central, _with_weight, at, delta, weight)
    yield case("measured δ", "noise below, curvature above", "gradients right to a thousandth", _chosen_step)
    yield case("ZOO, 8 steps", "λ 0", recurrence, _adam, 8, 0.0)
    yield case("ZOO, 8 steps, λ 0.5", "λ pulls back", recurrence, _adam, 8, 0.5)


def _rendered_fgsm(renderer: Renderer, group: str, steps: int, **settings: Any) -> tuple[AttackRun, Parameters]:
    """The attack after all its steps, and its last perturbation, which need not be the one that it stored."""
    problem = linear_problem(renderer, (group,))
    fields = {"renderer": renderer.name, "groups": (group,), "truncation": None, "steps": steps}
    attack = FGSM.model_validate(fields | settings)
    run = attacked(problem, attack)
    need(all(np.isfinite(row.perceptibility) for row in run.trace), "a perceptibility is not finite")
    return run, problem.layout.unflatten(run.state["delta"])


def _small(name: str) -> Renderer:
    """The renderer of that name for 8² or 16² pixels."""
    return pixels() if name == "image" else build(placed(size=(16, 16)), name)


def _no_step(name: str, group: str) -> Measured:
    """η = 0 moves nothing, however often."""
    renderer = _small(name)
    run, last = _rendered_fgsm(renderer, group, 120, learning_rate={group: 0.0})
    need(not bool(last[group].any()), "the perturbation is not zero")
    # Images with a gradient may be computed in another order than the original, to float32's rounding.
    moved = max(row.perceptibility for row in run.trace)
    need(len({row.perceptibility for row in run.trace}) == 1, "the image changes from step to step")
    return Measured(moved, 2e-7, "largest perceptibility in 120 steps, all alike; the perturbation is exactly 0")


def _giant_step(group: str) -> Measured:
    """η = 1e3: the parameters stay within bounds, and images of them are those of the definition."""
    shading = Shading.of(placed(radiance=sky(), size=(16, 16)))
    renderer = shading.renderer
    _, last = _rendered_fgsm(renderer, group, 120, learning_rate={group: 1e3})
    low, high = renderer.bounds()[group]
    value = renderer.initial()[group] + last[group]
    need(bool(torch.isfinite(value).all()), "a parameter is not finite")
    need(largest(last[group]) > 1.0, "it does not move")
    rounding = 1e-6 * (1 + value.abs())
    need(bool((value >= low - rounding).all() and (value <= high + rounding).all()), "a parameter is out of bounds")
    return shading.errors({group: value}).within(SHARP)


def _far_angles() -> Measured:
    """The furthest that 120 steps of η = 1e3 can go: normals moved by a million radians, in any direction."""
    shading = Shading.of(placed(radiance=sky(), size=(16, 16)))
    renderer = shading.renderer
    problem = linear_problem(renderer, ("normals",))
    shape = renderer.initial()["normals"].shape
    moved = 2e6 * torch.rand(shape, generator=torch.Generator().manual_seed(9)) - 1e6
    value = renderer.initial()["normals"] + problem.limits.clamp(moved.flatten()).reshape(shape)
    with torch.no_grad():
        seen = renderer.render({"normals": value[None]})[0]
    need(largest(seen - problem.original[0]) > 0.01, "it does not move")
    need(largest(value) < 1000, "float32 does not tell such angles apart")
    return shading.errors({"normals": value}).within(SHARP)


def _giant_zoo() -> Measured:
    """η = 1e3 through pyrender: out of the image and beyond every light, within bounds and finite."""
    renderer = _small("pyrender")
    problem = linear_problem(renderer)
    attack = ZOO(method="zoo", renderer="pyrender", delta=1e-2, learning_rate=1e3, steps=20)
    run = attacked(problem, attack)
    outside, last = 0.0, problem.layout.unflatten(run.state["delta"])
    for group, change in last.items():
        low, high = renderer.bounds()[group]
        value = renderer.initial()[group] + change
        need(bool(torch.isfinite(value).all()), f"{group} is not finite")
        outside = max(outside, float((low - value).clamp_min(0).max()), float((value - high).clamp_min(0).max()))
    need(max(largest(v) for v in last.values()) > 100, "it does not move")
    need(all(np.isfinite(row.perceptibility) for row in run.trace), "a perceptibility is not finite")
    return Measured(outside, 1e-6, "how far any parameter is out of its bounds after 20 steps")


def _giant_decay() -> Measured:
    """η = 1e3 and decay 1 would multiply the perturbation by 1,000 a step; pixels are held in [0,1]."""
    renderer = pixels()
    _, last = _rendered_fgsm(renderer, "image", 120, learning_rate={"image": 1e3}, weight_decay=1.0)
    shown = renderer.initial()["image"] + last["image"]
    need(bool(torch.isfinite(shown).all()), "a pixel is not finite")
    return Measured(float(torch.maximum(-shown, shown - 1).max()), 1e-7, "how far any pixel is out of [0,1]")


def _no_gradient() -> Measured:
    """A black object shows no light, material or normals: 120 steps with zero gradients, all reported flat."""
    renderer = build(placed(thing={"color": (0, 0, 0)}, size=(16, 16)), "torch")
    problem = linear_problem(renderer)
    attack = FGSM(groups=renderer.plan.groups, steps=120)
    run = attacked(problem, attack)
    reported = [row.below_noise for row in run.trace]
    need(reported == [0] + [3] * 120, "not all three groups are reported flat at every step")
    need(run.stopped == "steps", f"it stopped for {run.stopped}")
    moved = max(largest(v) for v in run.stored.values())
    return Measured(moved, 0.0, "largest perturbation; three of three groups reported flat, 120 times")


def _coasting() -> Measured:
    """Momentum over 120 steps with zero gradients, after one push: a closed form, the power of a 2×2 matrix."""
    renderer = build(placed(thing={"color": (0, 0, 0)}, size=(16, 16)), "torch")
    problem = linear_problem(renderer, ("illumination",))
    rate, momentum, decay = 3e-3, 0.9, 1e-2
    rates = {"illumination": rate}
    settings = {"groups": ("illumination",), "learning_rate": rates, "weight_decay": decay, "steps": 120}
    run = AttackRun.begin_or_resume(problem, FGSM.model_validate(settings), Verifier.of(problem))
    run.state["velocity"] = torch.full_like(run.state["velocity"], -1.0)
    run_attack(run)
    # (Δ, v) → v' = momentum·v + decay·Δ, Δ' = Δ − rate·v'
    step = np.array([[1 - rate * decay, -rate * momentum], [decay, momentum]])
    reference = float((np.linalg.matrix_power(step, 120) @ np.array([0.0, -1.0]))[0])
    need(run.step == 120, f"it stopped after {run.step} steps")
    error = (run.stored["illumination"].double() - reference).abs().max()
    return Measured(float(error) / reference, 1e-5, "relative error of the perturbation, closed form")


def _at_the_limit() -> Measured:
    """U: a value moved by exactly 18/255 is not beyond it, one moved by a hundredth of a step more is held there."""
    original = (torch.arange(0, 237).repeat_interleave(3).reshape(1, 1, 237, 3) / 255).float()
    limit = 18 / 255
    at, held_at = truncate(original + torch.tensor(18.0) / 255, original, limit)
    beyond, held_beyond = truncate(original + 18.01 / 255, original, limit)
    need(int(held_at.sum()) == 0, f"{int(held_at.sum())} of 237 pixels at the limit are held")
    need(int(held_beyond.sum()) == 237, f"{237 - int(held_beyond.sum())} of 237 pixels beyond the limit are not held")
    need(bool((at >= original).all()), "a pixel went the wrong way")
    return Measured(largest(beyond - original - limit), 1e-7, "distance of a held value from the limit")


def step_cases() -> Iterator[Case]:
    """The cases of this family."""
    bounded, giant = "in bounds, and images by the definition", "120 steps of 1,000 and more"
    lost, held = "float32 has 0.06 radians left there", "held where it has 1e-5, and the definition's image"
    flat, equals = "stays, and every step is reported flat", "a comparison of equals"
    yield case("η = 0, pixels", "no step", "nothing moves", _no_step, "image", "image")
    yield case("η = 0, torch", "no step", "nothing moves", _no_step, "torch", "material")
    for group in ("normals", "illumination", "material"):
        yield case(f"η = 1e3, {group}", giant, bounded, _giant_step, group, held="clipped")
    yield case("normals + 1e6", lost, held, _far_angles, held="clipped")
    yield case("η = 1e3, pyrender", "20 steps of 1,000", "in bounds and finite", _giant_zoo, held="clipped")
    yield case("η = 1e3, decay 1", "×1,000 a step", "in bounds", _giant_decay, held="clipped")
    yield case("no gradient, 120 steps", "a black object", flat, _no_gradient, held="flat")
    yield case("momentum, no gradient", "120 steps after one push", "the closed form", _coasting)
    yield case("moved by exactly U", equals, "18/255 is not beyond 18/255", _at_the_limit, held="clipped")


def _too_small(name: str, group: str) -> Measured:
    """Differences that round to nothing are called flat, and their gradient is 0."""
    problem = linear_problem(_small(name), (group,), lead=0.0)
    count = min(problem.layout.total, 24)
    deltas = torch.full((count,), 1e-12, dtype=torch.float64)
    nothing = problem.layout.zeros()
    estimated = estimate(problem, nothing, torch.arange(count), deltas, measure_noise(problem, nothing))
    flat = int(estimated.below_noise.sum())
    need(flat == count, f"{count - flat} of {count} differences are not called flat")
    return Measured(largest(estimated.gradients), 0.0, f"largest gradient; all {count} differences reported flat")


def _zoo_flat() -> Measured:
    """An attack all of whose differences are flat goes nowhere, and every row of its trace says so."""
    problem = linear_problem(pixels())
    run = attacked(problem, ZOO(method="zoo", renderer="image", delta=1e-12, coordinates=50, steps=3))
    reported = [row.below_noise for row in run.trace]
    need(reported == [0, 50, 50, 50], f"reported below the noise: {reported}")
    need(not any(bool(run.state[name].any()) for name in ("first", "second", "moves")), "Adam moved")
    return Measured(largest(run.stored["image"]), 0.0, "largest perturbation; all differences reported flat")


def _gradients(delta: float, at: float = 0.0) -> tuple[Tensor, Tensor, Tensor, float]:
    """Returns gradients by differences of pixels, their closed form, which of them are flat, and the noise."""
    problem = linear_problem(pixels(), lead=0.0)
    start = torch.full((3 * SIDE * SIDE,), at)
    noise = measure_noise(problem, start)
    deltas = torch.full((len(start),), delta, dtype=torch.float64)
    estimated = estimate(problem, start, torch.arange(len(start)), deltas, noise)
    return estimated.gradients, linear_gradient().flatten(), estimated.below_noise, noise


def _too_large() -> Measured:
    """A step of 1 leaves [0,1] on both sides: it is held at the bounds, and the way between them divides."""
    gradients, reference, flat, _ = _gradients(1.0)
    need(not bool(flat.any()), "a difference is called flat")
    error = largest(gradients - reference) / largest(reference)
    return Measured(error, 1e-5, "relative error of a gradient, closed form")


def _sweep() -> Measured:
    """At every step from 1e-1 to 1e-12 a gradient is right to the noise over the step, or called flat."""
    worst = 0.0
    for exponent in range(1, 13):
        delta = 10.0**-exponent
        gradients, reference, flat, noise = _gradients(delta, at=0.1)
        need(exponent > 3 or not bool(flat.all()), f"all differences of {delta:g} are flat")
        error = (gradients - reference).abs()[~flat]
        if len(error):
            worst = max(worst, float(error.max()) * 2 * delta / (noise + 1e-5 * 2 * delta * largest(reference)))
    return Measured(worst, 1.0, "error of a gradient that is not flat, in units of the noise over the step")


def difference_cases() -> Iterator[Case]:
    """The cases of this family."""
    flat = "called flat, gradient 0"
    below, mixed = "below float32's rounding", "float64 parameters, float32 images"
    yield case("δ = 1e-12, pixels", below, flat, _too_small, "image", "image", held="flat")
    yield case("δ = 1e-12, pyrender", mixed, flat, _too_small, "pyrender", "illumination", held="flat")
    yield case("δ = 1e-12, torch", below, flat, _too_small, "torch", "material", held="flat")
    yield case("ZOO with δ = 1e-12", "nothing to go by", "goes nowhere, and says so", _zoo_flat, held="flat")
    yield case("δ = 1", "beyond both bounds", "the gradient is right", _too_large, held="clipped")
    yield case("δ from 1e-1 to 1e-12", "differences drown in rounding", "right to the noise, or flat", _sweep)
