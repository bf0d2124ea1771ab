"""The re-rendering defence: fit the scene's parameters to an image, and classify the fitted scene's image instead.

The paper finds that image-space adversaries cannot be explained by physical parameters, so that the rendering of the
best fit has the original label again (section 4.1.1). Who defends this way knows the scene: its meshes, camera, and the
light and materials from which the fit starts. A fit (`fitted`) is the smallest ℓ1 distance that gradient descent from
the scene's values finds; of the torch renderer it has normals, illumination and material.

`attack_through` is an attack by somebody who knows the defence: the pixels of an image are attacked so that the
*rendering of the scene fitted to them* is misclassified. A fit has no useful derivative, so the gradient at the
rendering is passed on to the pixels as it is: backward pass differentiable approximation (BPDA; Athalye, Carlini and
Wagner 2018), with the identity for the defence. That is what a defence is worth: one that only hides the gradient falls
to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Literal

import torch
from torch import Tensor

from scene_attack.analysis.attribution import Tick
from scene_attack.analysis.images import of_images
from scene_attack.analysis.records import (
    AdaptiveAttack,
    Explanation,
    Interpretation,
    Rerendering,
    RerenderingRequest,
    Said,
)
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import check_graph
from scene_attack.attacks.run import Verifier
from scene_attack.errors import JobFailure
from scene_attack.process import finite
from scene_attack.rendering.color import from_bytes, to_bytes
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.targets.scores import probability

Optimiser = Literal["sgd", "adam"]


@dataclass(frozen=True)
class Fit:
    """The best of the fits that the optimiser went through."""

    perturbation: Parameters
    """The change from the scene's values that leads to it, by group."""
    losses: list[float]
    """Mean absolute difference of a displayed value at the start and after each step, [0,1]."""


def fit(
    renderer: Renderer, image: Tensor, optimiser: Optimiser, rate: float, steps: int, tick: Callable[[int], None]
) -> Fit:
    """Minimises ‖image − render(X₀ + ΔX)‖₁ over ΔX, from 0, by steps of one learning rate for all groups.

    ΔX has the groups for which the renderer is compiled. `image` is [H, W, 3] in [0,1], of the renderer's size. The
    norm is the sum over values, as in the paper; the units of the groups are those of the renderer. After each step the
    parameters are clamped to the renderer's bounds.
    `tick` is called before each image with the number of those rendered. Raises JobFailure("non-finite") if the
    distance or a gradient is not finite.
    """
    initial, bounds = renderer.initial(), renderer.bounds()
    start = {group: initial[group] for group in renderer.plan.groups}
    moved = {group: torch.zeros_like(value).requires_grad_() for group, value in start.items()}
    kind = torch.optim.SGD if optimiser == "sgd" else torch.optim.Adam
    stepper = kind(moved.values(), lr=rate)
    target, losses = image.to(torch.float64), list[float]()
    best: Parameters = {}
    for step in range(steps + 1):
        tick(step)
        with torch.set_grad_enabled(step < steps):
            [shown] = renderer.render({group: (start[group] + moved[group])[None] for group in moved})
            distance = (shown.double() - target.to(shown.device)).abs().sum()
        losses.append(float(distance.detach()) / image.numel())
        if not finite(distance):
            raise JobFailure("non-finite", "the distance of a fit is not finite")
        if losses[-1] == min(losses):
            best = {group: value.detach().clone() for group, value in moved.items()}
        if step == steps:
            break
        stepper.zero_grad()
        distance.backward()
        if not all(value.grad is None or finite(value.grad) for value in moved.values()):
            raise JobFailure("non-finite", "the gradient of a fit has values that are not finite")
        stepper.step()
        with torch.no_grad():
            for group, value in moved.items():
                low, high = bounds[group]
                value.clamp_(low - start[group], high - start[group])
    return Fit(best, losses)


RATES = (1e-3, 1e-4, 1e-5)
OPTIMISERS: tuple[Optimiser, ...] = ("sgd", "adam")
"""The paper's learning rates and optimisers."""


def said(logits: Tensor, labels: Sequence[str]) -> Said:
    """The answer that scores [K] give."""
    index = int(logits.argmax())
    return Said(label=labels[index], confidence=float(probability(logits, index)))


def interpret(verifier: Verifier, image: Tensor, steps: int, tick: Tick) -> Interpretation:
    """Fits the parameters of the verifier's renderer to an image, uint8 [H, W, 3], with each rate and optimiser.

    The renderer must be differentiable. `tick` is called before each image that is rendered.
    """
    labels, each = verifier.target.labels, steps + 2
    fits: list[Explanation] = []
    for number, (optimiser, rate) in enumerate(product(OPTIMISERS, RATES)):
        asked = RerenderingRequest(optimiser=optimiser, rate=rate, steps=steps)
        begun, total = number * each, len(OPTIMISERS) * len(RATES) * each
        best, rendered = fitted(verifier, image, asked, partial(_tick_from, tick, begun, total))
        fits.append(
            Explanation(
                optimiser=optimiser,
                rate=rate,
                losses=best.losses,
                after=said(verifier.logits(rendered), labels),
                distance=of_images(image, rendered),
            )
        )
    start = verifier.image({})
    return Interpretation(
        image=said(verifier.logits(image), labels), scene=said(verifier.logits(start), labels), fits=fits
    )


def _tick_from(tick: Callable[[int, int], None], begun: int, total: int, step: int) -> None:
    tick(begun + step, total)


def rerender(verifier: Verifier, image: Tensor, request: RerenderingRequest, tick: Tick) -> tuple[Rerendering, Tensor]:
    """Fits once; returns the answers to the image and to the rendering of the fit, and that image, uint8 [H, W, 3]."""
    labels = verifier.target.labels
    best, rendered = fitted(verifier, image, request, lambda step: tick(step, request.steps + 2))
    record = Rerendering(
        optimiser=request.optimiser,
        rate=request.rate,
        losses=best.losses,
        before=said(verifier.logits(image), labels),
        after=said(verifier.logits(rendered), labels),
        distance=of_images(image, rendered),
    )
    return record, rendered


def fitted(
    verifier: Verifier, image: Tensor, asked: RerenderingRequest, tick: Callable[[int], None]
) -> tuple[Fit, Tensor]:
    """A fit to an image, uint8 [H, W, 3], and its exact rendering, uint8 [H, W, 3]."""
    best = fit(verifier.renderer, from_bytes(image), asked.optimiser, asked.rate, asked.steps, tick)
    tick(asked.steps + 1)
    return best, verifier.image(best.perturbation)


RATE = 0.002
"""Step of each pixel value, that of the paper's attack on pixels."""
LIMIT = 18 / 255
"""Largest change of a pixel value from the original, the paper's U."""


def attack_through(
    verifier: Verifier, goal: ResolvedGoal, original: Tensor, *, fit: RerenderingRequest, steps: int, tick: Tick
) -> AdaptiveAttack:
    """Attacks an image, uint8 [H, W, 3], by signed gradient steps with momentum 0.9, until the goal is met.

    At each step the image is rounded to 8 bits, the scene is fitted to it as `fit` says, and the network classifies the
    fit's exact rendering. `tick` is called before each image that is rendered. The target must be differentiable.
    """
    start = from_bytes(original)
    moved, velocity = start.clone(), torch.zeros_like(start)
    each, trace = fit.steps + 2, list[float]()
    for step in range(steps + 1):
        saved = to_bytes(moved)

        def count(done: int, before: int = step * each) -> None:
            tick(before + done, (steps + 1) * each)

        _, rendered = fitted(verifier, saved, fit, count)
        shown = from_bytes(rendered)[None].requires_grad_()
        logits = verifier.target.logits(shown)
        verifier.counts.queries += 1
        check_graph(verifier.renderer, verifier.target, shown, logits)
        trace.append(float(goal.probability(logits.detach()[0])))
        met = bool(goal.fooled(logits.detach()[0]))
        if met or step == steps:
            break
        [gradient] = torch.autograd.grad(goal.objective(logits).sum(), shown)
        velocity = 0.9 * velocity + gradient[0].sign()
        moved = (moved - RATE * velocity).clamp(start - LIMIT, start + LIMIT).clamp(0, 1)
    return AdaptiveAttack(
        fooled=met,
        steps=step,
        goal_probability=trace,
        image=said(verifier.logits(saved), verifier.target.labels),
        rerendered=said(logits.detach()[0], verifier.target.labels),
        perceptibility=of_images(original, saved),
    )
