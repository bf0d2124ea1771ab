"""Attacks on a linear network and pixels, whose every step is known: the recurrences written down again in numpy."""

from functools import partial
from typing import Any

import numpy as np
import torch

from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.linear import linear_gradient, linear_problem, pixels
from services.attacks.differences import CANDIDATES, estimate, measure_noise
from services.attacks.fgsm import Fgsm, FgsmMethod
from services.attacks.run import AttackState, Budget, Verifier, run
from services.attacks.zoo import Zoo, ZooMethod
from services.scenes.mesh import Doubles

LIMIT = 18 / 255
"""U of the paper."""

FLOAT32 = 1e-6
"""Rounding of a perturbation below 1 after some tens of float32 sums."""


def _start() -> Doubles:
    return pixels().initial()["image"].double().numpy()


def _fgsm(steps: int, rate: float, begin: Doubles | None = None, **settings: Any) -> tuple[AttackState, FgsmMethod]:
    """FGSM on the pixels for some steps, from the perturbation `begin` if there is one."""
    renderer = pixels()
    given = {"renderer": "image", "learning_rate": {"image": rate}, "truncation": None} | settings
    spec = Fgsm.model_validate(given)
    limit = None if spec.truncation is None else spec.truncation / 255
    problem = linear_problem(renderer, truncation=limit)
    method = FgsmMethod(spec, problem)
    if begin is not None:
        method.load(method.state() | {"perturbation.image": torch.from_numpy(begin).float()})
    found = run(problem, method, Verifier(renderer, problem.target), Budget(steps))
    need(found.step == steps, f"it stopped after {found.step} steps")
    return found, method


def _momentum(steps: int, rate: float, momentum: float, decay: float, bounded: bool) -> Measured:
    """v ← μ v + sign(w) + decay Δ, Δ ← Δ − η v, held so that pixels stay in [0,1]; w is the network's own gradient."""
    found, method = _fgsm(steps, rate, momentum=momentum, weight_decay=decay)
    start, sign = _start(), np.sign(linear_gradient().numpy())
    delta, velocity = np.zeros_like(start), np.zeros_like(start)
    for _ in range(steps):
        velocity = momentum * velocity + sign + decay * delta
        delta = np.clip(delta - rate * velocity, -start, 1 - start)
    need(
        bounded == bool(((start + delta == 0) | (start + delta == 1)).any()), "bounds are met where they should not be"
    )
    error = np.abs(found.stored["image"].double().numpy() - delta).max()
    velocity_error = np.abs(method.state()["velocity.image"].double().numpy() - velocity).max() / np.abs(velocity).max()
    return Measured(max(float(error), float(velocity_error)), FLOAT32, "error of the perturbation and of the velocity")


def _held() -> Measured:
    """Steps of 0.1 are beyond U at once: nothing that is held back passes a gradient, so the first step is the last.

    What is shown is the original ± U.
    """
    found, _ = _fgsm(5, 0.1, momentum=0.0, weight_decay=0.0, truncation=18)
    sign = np.sign(linear_gradient().numpy())
    need([row.truncated for row in found.trace[1:]] == [64] * 5, "not all pixels are held")
    problem = linear_problem(pixels(), truncation=LIMIT)
    shown = problem.view(found.stored).images[0].double().numpy()
    error = np.abs(shown - (_start() - LIMIT * sign)).max()
    worst = max(float(error), float(np.abs(found.stored["image"].double().numpy() + 0.1 * sign).max()))
    return Measured(worst, FLOAT32, "error of the perturbation, −0.1 sign(w), and of the image, original ± U")


def _partly_held() -> Measured:
    """Of each pixel one value is beyond U and two are not: the step moves those two only."""
    begin = np.full_like(_start(), 0.5 * LIMIT)
    begin[..., 1] = -1.5 * LIMIT
    found, _ = _fgsm(1, 0.01, begin, momentum=0.0, weight_decay=0.0, truncation=18)
    wanted = begin - 0.01 * np.sign(linear_gradient().numpy()) * (np.abs(begin) < LIMIT)
    error = np.abs(found.stored["image"].double().numpy() - wanted).max()
    return Measured(float(error), FLOAT32, "error of the perturbation")


def _with_weight(at: float, delta: float, weight: float) -> Measured:
    """The objective is linear in the pixels plus λ‖Δ‖², so that a central difference is w + 2 λ Δ whatever its step."""
    problem = linear_problem(pixels(), lead=0.0, weight=weight)
    random = np.random.default_rng(6)
    where = at * random.choice([-1.0, 1.0], size=_start().size)
    start = torch.from_numpy(where).float()
    deltas = torch.full((len(where),), delta, dtype=torch.float64)
    found = estimate(problem, start, torch.arange(len(where)), deltas, measure_noise(problem, start))
    wanted = linear_gradient().flatten().numpy() + 2 * weight * where
    error = np.abs(found.gradients.double().numpy() - wanted).max() / np.abs(wanted).max()
    # float32 scores of about 1 have 1e-6, over twice the step.
    return Measured(float(error), 1e-6 / delta, "relative error of a gradient, closed form")


def _chosen_step() -> Measured:
    """The measured difference step is one under which gradients are right to a thousandth."""
    problem = linear_problem(pixels(), lead=0.0, weight=0.5)
    method = ZooMethod(Zoo(method="zoo", renderer="image", delta="measured", learning_rate=0.01), problem)
    chosen = method.start(problem)["delta"]
    need(isinstance(chosen, dict) and chosen["image"] in CANDIDATES[1:-1], f"it chose {chosen}")
    deltas = method.half_steps
    found = estimate(problem, torch.zeros(len(deltas)), torch.arange(len(deltas)), deltas, method.noise)
    wanted = linear_gradient().flatten()
    error = (found.gradients.double() - wanted).abs().max() / wanted.abs().max()
    return Measured(float(error), 1e-3, "relative error of a gradient, closed form")


def _adam(steps: int, weight: float) -> Measured:
    """ZOO on all coordinates at once, against Adam (Kingma and Ba 2015, algorithm 1) on the gradient w + 2 λ Δ."""
    rate = 0.01
    problem = linear_problem(pixels(), lead=0.0, weight=weight)
    settings = Zoo(method="zoo", renderer="image", delta=1e-2, learning_rate=rate, weight=weight, coordinates=192)
    method = ZooMethod(settings, problem)
    method.start(problem)
    w = linear_gradient().numpy().ravel()
    delta, first, second = (np.zeros_like(w) for _ in range(3))
    for step in range(1, steps + 1):
        below = method.advance(problem, problem.view(method.perturbation), step)
        need(below <= 2, f"{below} differences are below the noise")
        gradient = w + 2 * weight * delta
        first, second = 0.9 * first + 0.1 * gradient, 0.999 * second + 0.001 * gradient**2
        delta = delta - rate * (first / (1 - 0.9**step)) / (np.sqrt(second / (1 - 0.999**step)) + 1e-8)
    found = method.perturbation["image"].double().numpy().ravel()
    # A difference has 1e-4, and Adam's quotient the relative error of its gradients: those that pass 0 are left out.
    large = np.abs(w) > 2.5 * weight * rate * steps + 0.01
    need(large.mean() > 0.5, f"only {large.mean():.0%} of the gradients are large")
    return Measured(float(np.abs(found - delta)[large].max()) / rate, 1e-2, "error of the perturbation, in steps")


def cases() -> list[Case]:
    """The cases of this family."""
    family, recurrence = "recurrences", "the recurrence, written down again"
    central, beside = "w + 2 λ Δ", "a quadratic objective, away from the start"
    return [
        Case("signs alone", family, "no momentum", recurrence, lambda: _momentum(10, 1e-3, 0.0, 0.0, False)),
        Case("momentum", family, "10 steps of η = 1e-3", recurrence, lambda: _momentum(10, 1e-3, 0.9, 0.0, False)),
        Case("decay", family, "a pull of 1", recurrence, lambda: _momentum(10, 1e-2, 0.5, 1.0, False)),
        Case(
            "momentum against bounds",
            family,
            "pixels at 0 and 1",
            recurrence,
            lambda: _momentum(30, 2e-2, 0.9, 0.1, True),
            "clipped",
        ),
        Case("all beyond U", family, "no gradient left", "the first step is the last", _held, "clipped"),
        Case(
            "a third beyond U", family, "gradients of two of three values", "only these move", _partly_held, "clipped"
        ),
        *(
            Case(f"difference, λ {weight:g}, δ {delta:g}", family, beside, central, partial(_with_weight, *row))
            for row in ((0.1, 0.05, 3.0), (0.1, 0.01, 0.3), (0.05, 0.1, 10.0))
            for _, delta, weight in (row,)
        ),
        Case("measured δ", family, "noise below, curvature above", "gradients right to a thousandth", _chosen_step),
        Case("ZOO, 8 steps", family, "λ 0", recurrence, lambda: _adam(8, 0.0)),
        Case("ZOO, 8 steps, λ 0.5", family, "λ pulls back", recurrence, lambda: _adam(8, 0.5)),
    ]
