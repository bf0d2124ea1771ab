"""Differences over steps that are far too small, or far too large."""

import torch
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.linear import SIDE, linear_gradient, linear_problem, pixels
from services.attacks.differences import estimate, measure_noise
from services.attacks.run import Budget, Verifier, run
from services.attacks.zoo import Zoo, ZooMethod
from services.rendering.factory import build
from services.rendering.protocol import Renderer


def _too_small(renderer: Renderer, group: str) -> Measured:
    """Differences that round to nothing are called flat, and their gradient is 0."""
    problem = linear_problem(renderer, (group,), lead=0.0)
    count = min(problem.layout.total, 24)
    deltas = torch.full((count,), 1e-12, dtype=torch.float64)
    nothing = problem.layout.zeros()
    found = estimate(problem, nothing, torch.arange(count), deltas, measure_noise(problem, nothing))
    need(bool(found.below_noise.all()), f"{int((~found.below_noise).sum())} of {count} differences are not called flat")
    return Measured(
        float(found.gradients.abs().max()), 0.0, f"largest gradient; {count} of {count} differences reported flat"
    )


def _zoo_flat() -> Measured:
    """An attack all of whose differences are flat goes nowhere, and every row of its trace says so."""
    renderer = pixels()
    problem = linear_problem(renderer)
    method = ZooMethod(Zoo(method="zoo", renderer="image", delta=1e-12, coordinates=50, steps=3), problem)
    found = run(problem, method, Verifier(renderer, problem.target), Budget(3))
    reported = [row.below_noise for row in found.trace]
    need(reported == [0, 50, 50, 50], f"reported below the noise: {reported}")
    need(not any(bool(v.any()) for n, v in method.state().items() if n in ("first", "second", "moves")), "Adam moved")
    return Measured(
        float(found.stored["image"].abs().max()), 0.0, "largest perturbation; all differences reported flat"
    )


def _gradients(delta: float, at: float = 0.0) -> tuple[Tensor, Tensor, Tensor, float]:
    """Gradients, their closed form, which are flat, and the noise, of differences of pixels."""
    problem = linear_problem(pixels(), lead=0.0)
    start = torch.full((3 * SIDE * SIDE,), at)
    noise = measure_noise(problem, start)
    deltas = torch.full((len(start),), delta, dtype=torch.float64)
    found = estimate(problem, start, torch.arange(len(start)), deltas, noise)
    return found.gradients, linear_gradient().flatten(), found.below_noise, noise


def _too_large() -> Measured:
    """A step of 1 leaves [0,1] on both sides: it is held at the bounds, and the way between them divides."""
    gradients, wanted, flat, _ = _gradients(1.0)
    need(not bool(flat.any()), "a difference is called flat")
    return Measured(
        float((gradients - wanted).abs().max() / wanted.abs().max()), 1e-5, "relative error of a gradient, closed form"
    )


def _sweep() -> Measured:
    """At every step from 1e-1 to 1e-12 a gradient is right to the noise over the step, or called flat."""
    worst = 0.0
    for exponent in range(1, 13):
        delta = 10.0**-exponent
        gradients, wanted, flat, noise = _gradients(delta, at=0.1)
        need(exponent > 3 or not bool(flat.all()), f"all differences of {delta:g} are flat")
        error = (gradients - wanted).abs()[~flat]
        if len(error):
            worst = max(worst, float(error.max()) * 2 * delta / (noise + 1e-5 * 2 * delta * float(wanted.abs().max())))
    return Measured(worst, 1.0, "error of a gradient that is not flat, in units of the noise over the step")


def cases() -> list[Case]:
    """The cases of this family."""
    family, flat = "differences", "called flat, gradient 0"
    return [
        Case(
            "δ = 1e-12, pixels",
            family,
            "below float32's rounding",
            flat,
            lambda: _too_small(pixels(), "image"),
            "flat",
        ),
        Case(
            "δ = 1e-12, pyrender",
            family,
            "float64 parameters, float32 images",
            flat,
            lambda: _too_small(build(placed(size=(16, 16)), "pyrender"), "illumination"),
            "flat",
        ),
        Case(
            "δ = 1e-12, torch",
            family,
            "below float32's rounding",
            flat,
            lambda: _too_small(build(placed(size=(16, 16)), "torch"), "material"),
            "flat",
        ),
        Case("ZOO with δ = 1e-12", family, "nothing to go by", "goes nowhere, and says so", _zoo_flat, "flat"),
        Case("δ = 1", family, "beyond both bounds", "the gradient is right", _too_large, "clipped"),
        Case("δ from 1e-1 to 1e-12", family, "differences drown in rounding", "right to the noise, or flat", _sweep),
    ]
