"""Pictures of one pixel, of millions, and of one row; black and white surfaces."""

import numpy as np
import torch

from services.accuracy.placing import placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.linear import linear_network
from services.accuracy.stability.shading import EXACT, LOOP, Shading
from services.attacks.fgsm import Fgsm, FgsmMethod
from services.attacks.goal import ResolvedGoal
from services.attacks.loop import Budget, run
from services.attacks.problem import AttackProblem
from services.attacks.verifier import Verifier
from services.rendering.factory import build


def _picture(size: tuple[int, int]) -> Measured:
    """A sphere at this size; a few hundred covered pixels are looked at."""
    scene = placed("primitive/sphere", size=size, radiance=sky(), thing={"material": "plastic"})
    shading = Shading.of(scene)
    found, covered = shading.errors({}), int((shading.gbuffer.coverage > 0).sum())
    need(found.exact <= EXACT, f"the judge's picture is off by {found.exact:.1e}")
    return Measured(found.loop, LOOP, f"largest error of a displayed value, against the definition; {covered:,} pixels")


def _frames(size: tuple[int, int]) -> Measured:
    """pyrender at this size: the mean of the picture is that of the same view in 64 rows.

    One pixel has four samples of the outline and one of the shading, so it looks at a spot in the middle.
    """
    aspect, means = size[1] / size[0], []
    camera = {"field_of_view": 0.02} if size == (1, 1) else {}
    for frame in (size, (64, round(64 * aspect))):
        scene = placed("primitive/cube", size=frame, camera=camera)
        with torch.no_grad():
            picture = build(scene, "pyrender").render({})[0]
        need(float((picture - torch.tensor(scene.description.ground)).abs().max()) > 0.1, "the picture shows nothing")
        need(picture.shape == (*frame, 3), f"the picture is {tuple(picture.shape)}")
        need(bool(torch.isfinite(picture).all()), "the picture has values that are not finite")
        means.append(picture.double().mean(dim=(0, 1)))
    return Measured(
        float((means[0] - means[1]).abs().max()), 2e-3, "difference of the mean from the same view at 64 rows"
    )


def _attacked(size: tuple[int, int], renderer: str) -> Measured:
    """A whole attack at this size, network and verdict included."""
    drawn = build(placed(size=size, radiance=sky()), renderer)
    network = linear_network()
    label = int(network.logits(drawn.render({g: v[None] for g, v in drawn.initial().items()}).float()).argmax())
    problem = AttackProblem(drawn, network, ResolvedGoal(label, None), drawn.groups, truncation=18 / 255)
    far = dict.fromkeys(drawn.groups, 1.0)
    method = FgsmMethod(Fgsm.model_validate({"renderer": renderer, "learning_rate": far}), problem)
    found = run(problem, method, Verifier(drawn, network), Budget(5))
    need(found.trace[-1].truncated > 0, "it never comes to U")
    need(all(np.isfinite((row.loss, row.advantage, row.distance)).all() for row in found.trace), "a row is not finite")
    need(found.picture.shape == (*size, 3), f"the picture is {tuple(found.picture.shape)}")
    need(found.trace[-1].distance > 0, "it does not move")
    moved = (problem.view(found.stored).images - problem.original).abs().max()
    return Measured(float(moved), 18 / 255 + 1e-6, "largest change of a value; U is 18/255")


def _black() -> Measured:
    """A black surface is black, and has no slopes."""
    shading = Shading.of(placed(thing={"color": (0, 0, 0)}, radiance=sky()))
    with torch.no_grad():
        picture = shading.renderer.render({})[0]
    for group in shading.renderer.groups:
        slope, _ = shading.gradient({}, group)
        need(float(slope.abs().max()) == 0, f"the slope of {group} is not zero")
    full = shading.gbuffer.coverage == 1
    return Measured(
        float(picture[full].abs().max()), 0.0, "brightest displayed value of a covered pixel; all slopes are 0"
    )


def _white() -> Measured:
    """A white matte surface keeps its contrast: the exposure leaves room above it."""
    shading = Shading.of(placed(thing={"color": (1, 1, 1)}, radiance=sky()))
    found = shading.errors({})
    need(found.clipped == 0, f"{found.clipped:.0%} of the pixels are beyond white")
    need(found.exact <= EXACT, f"the judge's picture is off by {found.exact:.1e}")
    return Measured(found.loop, LOOP, "largest error of a displayed value, against the definition; none is clipped")


def cases() -> list[Case]:
    """The cases of this family."""
    family, same = "sizes", "the loop's picture has the tolerance, the judge's is exact"
    attack = "the attack runs, within U"
    return [
        Case("1 px, torch", family, "one pixel", same, lambda: _picture((1, 1))),
        Case("1 px, pyrender", family, "one pixel", "the mean of the picture", lambda: _frames((1, 1))),
        Case("1 px, attacked", family, "a network's input from one pixel", attack, lambda: _attacked((1, 1), "torch")),
        Case(
            "1 px, its own value",
            family,
            "a network's input from one pixel",
            attack,
            lambda: _attacked((1, 1), "image"),
        ),
        Case("1×300 px", family, "one row", same, lambda: _picture((1, 300))),
        Case("300×7 px, pyrender", family, "a narrow strip", "the mean of the picture", lambda: _frames((300, 7))),
        Case("257² px", family, "one more than a tile of the rasteriser", same, lambda: _picture((257, 257))),
        Case("2048² px, torch", family, "4 million pixels", same, lambda: _picture((2048, 2048)), slow=True),
        Case(
            "2048² px, pyrender",
            family,
            "4 million pixels, 4 samples",
            "the mean of the picture",
            lambda: _frames((2048, 2048)),
            slow=True,
        ),
        Case("black albedo", family, "reflects nothing", "black, slopes exactly 0", _black),
        Case("white albedo", family, "reflects everything", same + "; nothing is clipped", _white),
    ]
