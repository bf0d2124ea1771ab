"""Positions of objects in the image: tiny, huge, hidden, cut off or absent; after turns and moves; in images of one
pixel, of millions, and of one row.
"""

from collections.abc import Iterator
from math import cos, pi, sin, tan
from typing import Any

import numpy as np
import torch

from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem, evaluate
from scene_attack.rendering.factory import build
from scene_attack.rendering.opengl.gbuffer import FACTOR, GBuffer, rasterise
from scene_attack.rendering.protocol import Renderer
from scene_attack.scenes.mesh import FIT_RADIUS, Doubles, Longs
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.view import camera_to_world
from scene_attack_accuracy.placing import placed, sky
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.objects import attacked, box, linear_network, square
from scene_attack_accuracy.stability.references import cast, expected
from scene_attack_accuracy.stability.torch_shading import Shading

FRONT: dict[str, float] = {"azimuth": 0.0, "elevation": 0.0}
"""The camera on +z; with an odd size the ray through the middle pixel meets the origin."""

EDGES = 0.02
"""Share of covered samples that may differ from the rays': those within rounding of an edge."""

SURFACE = 1e-4
"""Error of a covered pixel's normal, base colour and depth (relative): float32 throughout, over
the frame's depth range. Pixels at edges inside the object may have more, as many as EDGES of them."""

CUBE = FIT_RADIUS / 3**0.5
"""Half the side of a cube of scale 1."""

SHOWN = 2e-6
"""Error of a displayed value of pyrender's: a dozen float32 products."""


def sound(scene: ResolvedScene) -> GBuffer:
    """Returns the G-buffer. Raises Broken unless its values are finite and its normals have unit length."""
    seen = rasterise(scene)
    for name in ("normals", "base_color", "depth", "coverage"):
        need(bool(torch.isfinite(getattr(seen, name)).all()), f"{name} has values that are not finite")
    normals = seen.normals[seen.coverage > 0].double().numpy()
    need(bool(np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5), "a normal is not of length 1")
    return seen


def against_rays(scene: ResolvedScene, covered: bool = False) -> Measured:
    """The rasterised coverage, depth, normals and base colours against rays through each sample.

    With `covered`, every pixel must be wholly covered.
    """
    seen = sound(scene)
    hits = cast(scene, FACTOR)
    share = hits.coverage.reshape(seen.coverage.shape)
    need(share.sum() > 0, "no ray meets anything")
    ours = seen.coverage.double().numpy()
    need(not covered or ours.min() == share.min() == 1, "a pixel is not wholly covered")
    off = float(np.abs(ours - share).sum() / share.sum())
    both = ((share == 1) & (ours == 1)).ravel()
    if both.any():
        normals = hits.mean(hits.normals)[both]
        leaning = np.linalg.norm(normals, axis=1) > 0.5  # the mean of opposite normals has no direction
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        far = np.linalg.norm(seen.normals.reshape(-1, 3).double().numpy()[both] - normals, axis=1)[leaning]
        depth = hits.mean(hits.depth)[both]
        deep = np.abs(seen.depth.double().numpy().ravel()[both] - depth) / depth
        color = np.abs(seen.base_color.reshape(-1, 3).double().numpy()[both] - hits.mean(hits.colors)[both])
        for name, error in (("depths", deep), ("normals", far), ("base colours", color)):
            typical = float(np.quantile(error, 1 - EDGES))
            need(typical < SURFACE, f"{name} are off by {typical:.1e}")
    return Measured(off, EDGES, "share of covered samples that differ from a ray through each, in float64")


def drawn_by(scene: ResolvedScene, name: str) -> tuple[Renderer, Renderer]:
    """The renderer of that name, and its exact twin."""
    renderer = build(scene, name)
    return renderer, renderer.exact()


def shown_at(pixels: Longs, *renderers: Renderer) -> Iterator[Doubles]:
    """Displayed values [P, 3] of the scene's own image at `pixels` [P], by each renderer."""
    for renderer in renderers:
        image = renderer.render({})[0]
        need(image.shape == (*renderer.size, 3), f"the image is {tuple(image.shape)}")
        need(bool(torch.isfinite(image).all()), "the image has values that are not finite")
        yield image.reshape(-1, 3)[pixels].double().numpy()


def _filled(thing: dict[str, Any], camera: dict[str, float]) -> Measured:
    """In front of, and inside, a cube that is all there is to see; drawn by both renderers."""
    scene = placed("primitive/cube", thing=thing, camera=camera)
    against_rays(scene, covered=True)
    reference = expected(scene)
    need(len(reference.pixels) > 100, f"only {len(reference.pixels)} pixels are flat")
    error = max(largest(image - reference.shown) for image in shown_at(reference.pixels, *drawn_by(scene, "pyrender")))
    return Measured(error, SHOWN, "largest error of pyrender's image against its formula; G-buffer as rays have it")


def _pole(elevation: float) -> Measured:
    """Straight above or below, where the up direction is undefined, the view is the limit of nearby views."""
    scene = placed("primitive/cone", camera={"elevation": elevation, "azimuth": 0.7})
    axes = scene.view[:3, :3]
    need(bool(np.abs(axes.T @ axes - np.eye(3)).max() < 1e-12), "the camera's axes are not at right angles")
    beside = scene.description.camera.model_copy(update={"elevation": elevation * (1 - 1e-9)})
    need(bool(np.abs(camera_to_world(beside) - scene.view).max() < 1e-8), "the view jumps at the pole")
    return against_rays(scene)


def _refused(thing: dict[str, Any], camera: dict[str, Any] | None = None) -> Measured:
    placed(size=(64, 64), thing=thing, camera=camera)
    return Measured(1.0, 0.0, "scenes resolved")


def _seen(mesh: str = "primitive/cube", **options: Any) -> Measured:
    """A scene against rays; `options` are the arguments of `placed`."""
    return against_rays(placed(mesh, **options))


def view_cases() -> Iterator[Case]:
    """The cases of this family."""
    rays, hidden = "coverage, depth, normals and colours as rays have them", "scene.objects.0"
    filled = "all covered, the surface as rays have it, pyrender's image by its formula"
    refused, floor = "a clear error names the object", "a floor from behind the camera to far"
    near = {"scale": 2.0, "translation": (0, 0, 1.77 - 2 * CUBE)}
    around = {"scale": 8.0, "rotation": (0.2, 0.3, 0.1)}
    plane = {"rotation": (-pi / 2, 0, 0), "translation": (0, -0.5, 0), "scale": 100.0}
    corner: dict[str, Any] = {"camera": FRONT, "thing": {"translation": (0.1, 0.1, 1.45)}}
    far, wide = {"distance": 100.0, "field_of_view": 0.015}, {"distance": 0.9, "field_of_view": 2.8}
    yield case("three pixels across", "scale 0.1 in 32²", rays, _seen, size=(32, 32), thing={"scale": 0.1})
    yield case("filling the frame", "0.03 in front of the camera", filled, _filled, near, FRONT)
    yield case("camera inside the object", "only back faces are seen", filled, _filled, around, {})
    yield case("cut by the near plane", floor, rays, _seen, "primitive/plane", camera=FRONT, thing=plane)
    yield case("cube around the near plane", "a corner 1e-3 from the eye", rays, _seen, size=(16, 16), **corner)
    yield case("out of view", "beside the frame", refused, _refused, {"translation": (50, 0, 0)}, refusal=hidden)
    yield case("behind the camera", "w < 0", refused, _refused, {"translation": (0, 0, 5)}, FRONT, refusal=hidden)
    yield case("less than a pixel", "scale 1e-3", refused, _refused, {"scale": 1e-3}, refusal=hidden)
    yield case("straight above", "elevation π/2", rays, _pole, pi / 2)
    yield case("straight below", "elevation −π/2", rays, _pole, -pi / 2)
    yield case("telephoto", "0.02 radians from 100 away", rays, _seen, "primitive/torus", camera=far, size=(12, 12))
    yield case("fish eye", "2.8 radians from 0.8 away", rays, _seen, camera=wide)


def _silhouette() -> Measured:
    """A black square before a white ground darkens the image by its area, whatever its edges cut.

    The camera's middle ray meets the square's middle; it is turned in its plane so that edges cross pixels at an angle.
    """
    side, distance, size = 0.7, 1.8, 24
    scene = placed(
        square(side),
        size=(size, size),
        camera=FRONT,
        thing={"color": (0, 0, 0), "rotation": (0.0, 0.0, 0.4)},
        lights={"ambient": 0.0, "points": []},
        ground=(1.0, 1.0, 1.0),
    )
    focal = size / 2 / tan(scene.description.camera.field_of_view / 2)
    area = (focal * side / distance) ** 2
    worst = 0.0
    for renderer in (*drawn_by(scene, "torch"), *drawn_by(scene, "pyrender")):
        with torch.no_grad():
            dark = float((1 - renderer.render({})[0].double()).mean(dim=2).sum())
        worst = max(worst, abs(dark / area - 1))
    return Measured(worst, EDGES, "relative error of the area, closed form; 4 and 16 samples a pixel")


def _dark_cube(place: tuple[float, float, float], camera: dict[str, float], **thing: Any) -> ResolvedScene:
    """A small black cube beside the origin, on a white ground."""
    dark, thing = {"ambient": 0.0, "points": []}, {"color": (0, 0, 0)} | thing
    return placed(box(place, 0.1), size=(48, 48), camera=camera, thing=thing, lights=dark, ground=(1, 1, 1))


def _middle(covered: Doubles) -> tuple[float, float]:
    """The middle of what covers an image of 48² by these shares [48, 48], in pixels right of and above its own."""
    need(covered.sum() > 4, "it is not seen")
    rows, columns = np.mgrid[:48, :48] + 0.5
    return (covered * columns).sum() / covered.sum() - 24, 24 - (covered * rows).sum() / covered.sum()


def _turned(by_attack: bool) -> Measured:
    """A small cube at +x of its object lands where it must after quarter turns, seen along three axes.

    A quarter turn takes +x to +y about z, and to −z about y. −z is to the right of a camera on +x, and up for one
    straight above. `by_attack`: the turn is the attack's, not the scene's.
    """
    on_x, on_y = FRONT | {"azimuth": pi / 2}, FRONT | {"elevation": pi / 2}
    worst = 0.0
    for turn, camera, right, up in (
        ((0.0, 0.0, 0.0), FRONT, 1, 0),
        ((0.0, 0.0, pi / 2), FRONT, 0, 1),
        ((0.0, pi / 2, 0.0), on_x, 1, 0),
        ((0.0, pi / 2, 0.0), on_y, 0, 1),
    ):
        scene = _dark_cube((0.3, 0, 0), camera, rotation=(0.0, 0.0, 0.0) if by_attack else turn)
        parameters = {"rotation": torch.tensor([[turn]], dtype=torch.float64)}
        images = [variant.render(parameters if by_attack else {})[0] for variant in drawn_by(scene, "pyrender")]
        covered = [1 - image.double().mean(dim=2).numpy() for image in images]
        covered += [] if by_attack else [rasterise(scene).coverage.double().numpy()]
        offset = 24 / tan(scene.description.camera.field_of_view / 2) * 0.3 / 1.8
        for x, y in map(_middle, covered):
            worst = max(worst, abs(x - offset * right), abs(y - offset * up))
    # The cube's near side is 3 % larger than its far side, and samples are a quarter of a pixel apart.
    return Measured(worst, 0.25, "distance of its middle from where it must be, in pixels")


def _moved_away(distance: float) -> Measured:
    """An attack moves the object out of the image, sideways and behind the camera: ground is left."""
    scene = placed(camera=FRONT)
    renderer = build(scene, "pyrender")
    moves = torch.tensor([[[distance, 0.0, 0.0]], [[0.0, 0.0, distance]], [[0.0, -distance, 0.0]]], dtype=torch.float64)
    images = renderer.render({"translation": moves})
    need(largest(renderer.render({}) - torch.tensor(scene.description.ground)) > 0.01, "it was never there")
    ground = torch.tensor(scene.description.ground, dtype=images.dtype)
    return Measured(largest(images - ground), 0.0, "largest difference from the ground")


def _looked_at() -> Measured:
    """An attack moves the camera, and a small cube beside the origin lands where the closed form of its view has it.

    Around, up to the bounds of the elevation, farther and nearer, and rolled over.
    """
    place = x, y, _ = 0.25, 0.35, 0.0
    scene = _dark_cube(place, FRONT)
    focal = 24 / tan(scene.description.camera.field_of_view / 2)
    worst = 0.0
    for renderer in drawn_by(scene, "pyrender"):
        low, high = (float(bound[1]) for bound in renderer.bounds()["camera"])
        for azimuth, elevation, distance, roll in (
            (0.9, 0.0, 1.8, 0.0),
            (-2.5, low, 1.8, 0.0),
            (0.4, high, 2.4, 0.5),
            (0.0, 0.3, 1.5, -pi / 2),
        ):
            camera = torch.tensor([[azimuth, elevation, distance, roll]], dtype=torch.float64)
            middle = _middle(1 - renderer.render({"camera": camera})[0].double().mean(dim=2).numpy())
            right = x * cos(azimuth)
            up = y * cos(elevation) - x * sin(azimuth) * sin(elevation)
            depth = distance - x * sin(azimuth) * cos(elevation) - y * sin(elevation)
            offsets = right * cos(roll) + up * sin(roll), up * cos(roll) - right * sin(roll)
            worst = max(worst, *(abs(m - focal * w / depth) for m, w in zip(middle, offsets, strict=True)))
    return Measured(worst, 0.25, "distance of its middle from where it must be, in pixels")


def pose_cases() -> Iterator[Case]:
    """The cases of this family."""
    yield case("silhouette of a square", "edges across pixels", "the square's area", _silhouette)
    yield case("turned object", "quarter turns, three views", "lands where it must", _turned, False)
    yield case("object turned by an attack", "quarter turns, three views", "lands where it must", _turned, True)
    yield case("camera moved by an attack", "to the poles, rolled over", "lands where it must", _looked_at)
    yield case("moved out of view", "a step of an attack, 1e3 away", "exactly the ground is left", _moved_away, 1e3)
    yield case("moved 1e15 away", "float32 positions", "exactly the ground is left", _moved_away, 1e15)


SPREAD = 1009
"""Approximate number of pixels of a large image that are compared; no multiple of its width, so that they are spread
all over it."""


def _image(size: tuple[int, int]) -> Measured:
    """A sphere at this size; a few hundred covered pixels are looked at."""
    scene = placed("primitive/sphere", size=size, radiance=sky(), thing={"material": "plastic"})
    shading = Shading.of(scene)
    errors, covered = shading.errors({}), int((shading.gbuffer.coverage > 0).sum())
    return errors.within(shading.due, f"; {covered:,} pixels")


def _flat_pixels(size: tuple[int, int]) -> Measured:
    """Compares pyrender at this size with the formula, at pixels that lie in one face of a cube.

    Of a large image a few hundred pixels are looked at, in rows and columns all over it.
    """
    camera = {"field_of_view": 0.02} if size == (1, 1) else {}
    scene = placed("primitive/cube", size=size, camera=camera, thing={"color": (0.7, 0.4, 0.1)})
    count = size[0] * size[1]
    reference = expected(scene, pixels=np.arange(0, count, max(1, count // SPREAD)))
    need(len(reference.pixels) > 0.2 * min(count, SPREAD), f"only {len(reference.pixels)} pixels are flat")
    shown = shown_at(reference.pixels, *drawn_by(scene, "pyrender"))
    worst = max(largest(image - reference.shown) for image in shown)
    what = f"largest error of a displayed value, against the formula; {len(reference.pixels)} pixels"
    return Measured(worst, SHOWN, what)


def _attacked(size: tuple[int, int], renderer: str) -> Measured:
    """A whole attack at this size, network and verdict included."""
    drawn = build(placed(size=size, radiance=sky()), renderer)
    network = linear_network()
    groups = drawn.plan.groups
    label = int(network.logits(drawn.render({g: drawn.initial()[g][None] for g in groups}).float()).argmax())
    problem = AttackProblem.of(
        drawn, network, ResolvedGoal((label,), None), Limits.of(drawn, groups, truncation=18 / 255)
    )
    far = dict.fromkeys(groups, 1.0)
    settings = FGSM.model_validate({"renderer": renderer, "learning_rate": far, "steps": 5})
    run = attacked(problem, settings)
    need(run.trace[-1].truncated > 0, "it never comes to U")
    assert run.best is not None
    need(run.best.saved.shape == (*size, 3), f"the image is {tuple(run.best.saved.shape)}")
    need(run.trace[-1].distance > 0, "it does not move")
    moved = (evaluate(problem, run.best.delta, 0).image - problem.original).abs().max()
    return Measured(float(moved), 18 / 255 + 1e-6, "largest change of a value; U is 18/255")


def _black() -> Measured:
    """A black surface is black, and has no gradients."""
    shading = Shading.of(placed(thing={"color": (0, 0, 0)}, radiance=sky()))
    with torch.no_grad():
        image = shading.renderer.render({})[0]
    for group in shading.renderer.plan.groups:
        gradient, _ = shading.gradient({}, group)
        need(largest(gradient) == 0, f"the gradient of {group} is not zero")
    full = shading.gbuffer.coverage == 1
    return Measured(largest(image[full]), 0.0, "brightest displayed value of a covered pixel; all gradients are 0")


def _white() -> Measured:
    """A white matte surface keeps its contrast: the exposure leaves room above it."""
    shading = Shading.of(placed(thing={"color": (1, 1, 1)}, radiance=sky()))
    errors = shading.errors({})
    need(errors.clipped == 0, f"{errors.clipped:.0%} of the pixels are beyond white")
    return errors.within(shading.due, "; none is clipped")


def size_cases() -> Iterator[Case]:
    """The cases of this family."""
    same = "the loop's image is within its tolerance, the exact image within rounding"
    attack, formula = "the attack runs, within U", "displayed values by the formula"
    yield case("1 px, torch", "one pixel", same, _image, (1, 1))
    yield case("1 px, pyrender", "one pixel", formula, _flat_pixels, (1, 1))
    yield case("1 px, attacked", "a network's input from one pixel", attack, _attacked, (1, 1), "torch")
    yield case("1 px, its own value", "a network's input from one pixel", attack, _attacked, (1, 1), "image")
    yield case("1×300 px", "one row", same, _image, (1, 300))
    yield case("300×7 px, pyrender", "a narrow strip", formula, _flat_pixels, (300, 7))
    yield case("257² px", "one more than a tile of the rasteriser", same, _image, (257, 257))
    yield case("2048² px, torch", "4 million pixels", same, _image, (2048, 2048), slow=True)
    yield case("2048² px, pyrender", "4 million pixels, 4 samples", formula, _flat_pixels, (2048, 2048), slow=True)
    yield case("black albedo", "reflects nothing", "black, gradients exactly 0", _black)
    yield case("white albedo", "reflects everything", same + "; nothing is clipped", _white)
