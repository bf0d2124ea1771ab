"""An attack on the re-rendering defence by somebody who knows it.

The pixels of an image are attacked so that the *rendering of the scene fitted to them* is misclassified. A fit has no
useful derivative, so the gradient at the rendering is passed on to the pixels as it is: backward pass differentiable
approximation (BPDA; Athalye, Carlini and Wagner 2018), with the identity for the defence. That is what a defence is
worth: one that only hides the gradient falls to it.
"""

import torch
from torch import Tensor

from services.analysis.attribution import Tick
from services.analysis.perceptibility import of_images
from services.analysis.records import AdaptiveAttack
from services.analysis.requests import RerenderingRequest
from services.analysis.rerendering import fitted, said
from services.attacks.goal import ResolvedGoal
from services.attacks.problem import check_graph
from services.attacks.run import Verifier
from services.rendering.color import from_bytes, to_bytes

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

        _, rendered = fitted(verifier, saved, fit.optimiser, fit.rate, fit.steps, count)
        shown = from_bytes(rendered)[None].requires_grad_()
        logits = verifier.target.logits(shown)
        verifier.queries += 1
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
