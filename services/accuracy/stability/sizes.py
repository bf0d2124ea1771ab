"""Images of one pixel, of millions, and of one row; black and white surfaces."""

import numpy as np
import torch

from services.accuracy.placing import placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.lamps import expected
from services.accuracy.stability.linear import linear_network
from services.accuracy.stability.shading import Shading
from services.accuracy.stability.views import SHOWN
from services.attacks.fgsm import Fgsm, FgsmMethod
from services.attacks.goal import ResolvedGoal
from services.attacks.problem import AttackProblem
from services.attacks.run import Budget, Verifier, run
from services.rendering.factory import build

SPREAD = 1009
"""About how many pixels of a large image are looked at; no multiple of its width, so that they are all over it."""


def _image(size: tuple[int, int]) -> Measured:
    """A sphere at this size; a few hundred covered pixels are looked at."""
    scene = placed("primitive/sphere", size=size, radiance=sky(), thing={"material": "plastic"})
    shading = Shading.of(scene)
    found, covered = shading.errors({}), int((shading.gbuffer.coverage > 0).sum())
    return found.within(shading.due, f"largest error of a displayed value, against the definition; {covered:,} pixels")


def _flat_pixels(size: tuple[int, int]) -> Measured:
    """pyrender at this size: pixels that lie in one face of a cube, against their formula.

    Of a large image a few hundred pixels are looked at, in rows and columns all over it.
    """
    camera = {"field_of_view": 0.02} if size == (1, 1) else {}
    scene = placed("primitive/cube", size=size, camera=camera, thing={"color": (0.7, 0.4, 0.1)})
    count = size[0] * size[1]
    wanted = expected(scene, pixels=np.arange(0, count, max(1, count // SPREAD)))
    need(len(wanted.pixels) > 0.2 * min(count, SPREAD), f"only {len(wanted.pixels)} pixels are flat")
    renderer = build(scene, "pyrender")
    worst = 0.0
    for one in (renderer, renderer.exact()):
        image = one.render({})[0]
        need(image.shape == (*size, 3), f"the image is {tuple(image.shape)}")
        need(bool(torch.isfinite(image).all()), "the image has values that are not finite")
        worst = max(worst, float(np.abs(image.reshape(-1, 3)[wanted.pixels].double().numpy() - wanted.shown).max()))
    what = f"largest error of a displayed value, against the formula; {len(wanted.pixels)} pixels"
    return Measured(worst, SHOWN, what)


def _attacked(size: tuple[int, int], renderer: str) -> Measured:
    """A whole attack at this size, network and verdict included."""
    drawn = build(placed(size=size, radiance=sky()), renderer)
    network = linear_network()
    groups = drawn.plan.groups
    label = int(network.logits(drawn.render({g: drawn.initial()[g][None] for g in groups}).float()).argmax())
    problem = AttackProblem(drawn, network, ResolvedGoal((label,), None), groups, truncation=18 / 255)
    far = dict.fromkeys(groups, 1.0)
    method = FgsmMethod(Fgsm.model_validate({"renderer": renderer, "learning_rate": far}), problem)
    found = run(problem, method, Verifier(drawn, network), Budget(5))
    need(found.trace[-1].truncated > 0, "it never comes to U")
    need(all(np.isfinite((row.loss, row.advantage, row.distance)).all() for row in found.trace), "a row is not finite")
    need(found.image.shape == (*size, 3), f"the image is {tuple(found.image.shape)}")
    need(found.trace[-1].distance > 0, "it does not move")
    moved = (problem.view(found.stored).images - problem.original).abs().max()
    return Measured(float(moved), 18 / 255 + 1e-6, "largest change of a value; U is 18/255")


def _black() -> Measured:
    """A black surface is black, and has no gradients."""
    shading = Shading.of(placed(thing={"color": (0, 0, 0)}, radiance=sky()))
    with torch.no_grad():
        image = shading.renderer.render({})[0]
    for group in shading.renderer.plan.groups:
        gradient, _ = shading.gradient({}, group)
        need(float(gradient.abs().max()) == 0, f"the gradient of {group} is not zero")
    full = shading.gbuffer.coverage == 1
    return Measured(
        float(image[full].abs().max()), 0.0, "brightest displayed value of a covered pixel; all gradients are 0"
    )


def _white() -> Measured:
    """A white matte surface keeps its contrast: the exposure leaves room above it."""
    shading = Shading.of(placed(thing={"color": (1, 1, 1)}, radiance=sky()))
    found = shading.errors({})
    need(found.clipped == 0, f"{found.clipped:.0%} of the pixels are beyond white")
    return found.within(shading.due, "largest error of a displayed value, against the definition; none is clipped")


def cases() -> list[Case]:
    """The cases of this family."""
    family, same = "sizes", "the loop's image is within its tolerance, the exact image within rounding"
    attack, formula = "the attack runs, within U", "displayed values by the formula"
    return [
        Case("1 px, torch", family, "one pixel", same, lambda: _image((1, 1))),
        Case("1 px, pyrender", family, "one pixel", formula, lambda: _flat_pixels((1, 1))),
        Case("1 px, attacked", family, "a network's input from one pixel", attack, lambda: _attacked((1, 1), "torch")),
        Case(
            "1 px, its own value",
            family,
            "a network's input from one pixel",
            attack,
            lambda: _attacked((1, 1), "image"),
        ),
        Case("1×300 px", family, "one row", same, lambda: _image((1, 300))),
        Case(
            "300×7 px, pyrender",
            family,
            "a narrow strip",
            formula,
            lambda: _flat_pixels((300, 7)),
        ),
        Case("257² px", family, "one more than a tile of the rasteriser", same, lambda: _image((257, 257))),
        Case("2048² px, torch", family, "4 million pixels", same, lambda: _image((2048, 2048)), slow=True),
        Case(
            "2048² px, pyrender",
            family,
            "4 million pixels, 4 samples",
            formula,
            lambda: _flat_pixels((2048, 2048)),
            slow=True,
        ),
        Case("black albedo", family, "reflects nothing", "black, gradients exactly 0", _black),
        Case("white albedo", family, "reflects everything", same + "; nothing is clipped", _white),
    ]
