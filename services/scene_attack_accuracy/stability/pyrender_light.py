"""Light and shadows of the pyrender renderer: by its formula, and against closed forms, with lights on the surface,
inside and among objects, at infinity, grazing and far too strong.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf, nan, pi, sin
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.rendering.torch.light import directions
from scene_attack.rendering.torch.surfaces import WHOLE, visibility
from scene_attack.scenes.description import Scene
from scene_attack.scenes.mesh import FIT_RADIUS, Doubles, Longs, Part
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack_accuracy.placing import library, placed
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.geometry import FRONT
from scene_attack_accuracy.stability.objects import ball
from scene_attack_accuracy.stability.references import Expected, Lamps, expected

MIDDLE = np.array([16 * 33 + 16])
"""The middle pixel of an image of 33²."""

FORMULA = 2e-6
"""Relative error of a radiance: float32 positions and a dozen float32 products (measured: 5e-7)."""


def _renderer(mesh: str = "primitive/sphere", ambient: float = 0.4) -> PyrenderRenderer:
    light = {"points": [{"energy": 30.0, "position": (0.0, 0.0, 3.0)}], "ambient": ambient}
    return PyrenderRenderer(placed(mesh, size=(33, 33), camera=FRONT, lights=light))


def radiance_at(
    renderer: PyrenderRenderer, pixels: Longs, light: Sequence[float] | None = None
) -> tuple[Doubles, Doubles]:
    """Radiance [P, 3] and opacity [P, 1] at `pixels` [P], under a `light` of the group's values; None: the scene's."""
    parameters = {} if light is None else {"illumination": torch.tensor([light], dtype=torch.float64)}
    values = renderer.radiance(parameters)[0].reshape(-1, 4)[pixels].double().numpy()
    return values[:, :3], values[:, 3:]


def formula_error(scene: ResolvedScene, reference: Expected, light: Sequence[float] | None = None) -> float:
    """Largest error of radiance, relative to the brightest, and of displayed values under a `light` as `radiance_at`
    has it, of both renderers."""
    need(len(reference.pixels) > 50, f"only {len(reference.pixels)} pixels are flat")
    brightest = float(reference.radiance.max())
    need(brightest > 0, "the light does nothing by its formula")
    renderer = PyrenderRenderer(scene)
    parameters = {} if light is None else {"illumination": torch.tensor([light], dtype=torch.float64)}
    worst = 0.0
    for variant in (renderer, renderer.exact()):
        radiance, _ = radiance_at(variant, reference.pixels, light)
        shown = variant.render(parameters)[0].reshape(-1, 3)[reference.pixels].double().numpy()
        worst = max(worst, largest(radiance - reference.radiance) / brightest, largest(shown - reference.shown))
    return worst


def _lit(renderer: PyrenderRenderer, energy: float, position: tuple[float, float, float]) -> Tensor:
    """Returns the image with the light there; its energy is in the group's unit of 30."""
    light = renderer.initial()["illumination"].clone()
    light[1:] = torch.tensor([energy, *position], dtype=light.dtype)
    image = renderer.render({"illumination": light[None]})[0]
    need(bool(torch.isfinite(image).all()), "the image has values that are not finite")
    return image


def _light_inside(position: tuple[float, float, float]) -> Measured:
    """A light inside a closed object lights nothing that is seen: the image is that of no light.

    On the outline front and back meet, closer than the depth buffer tells apart: there a sample may see the lit inside.
    """
    renderer = _renderer()
    inner = renderer.radiance({})[0, ..., 3] == 1
    shone = _lit(renderer, 1.0, (0, 0, 3)) - _lit(renderer, 0.0, (0, 0, 3))
    need(bool(inner.any()) and largest(shone) > 0.1, "the light does nothing outside either")
    differs = torch.zeros(renderer.size)
    for variant in (renderer, renderer.exact()):
        differs = differs.maximum((_lit(variant, 100.0, position) - _lit(variant, 0.0, position)).abs().amax(dim=-1))
    outline = float((differs[~inner] > 0).sum() / inner.sum())
    need(outline < 0.01, f"light leaks on the outline, at {outline:.1%} of the object's pixels")
    what = f"largest difference from the image without the light, within the outline; on it {outline:.1%} leak"
    return Measured(float(differs[inner].max()), 0.0, what)


def _opposite() -> Measured:
    """A light behind a square, exactly on the view axis: light and view are opposite, and have no half vector."""
    renderer = _renderer("primitive/plane")
    lit, dark = _lit(renderer, 100.0, (0, 0, -2.0)), _lit(renderer, 0.0, (0, 0, -2.0))
    return Measured(largest(lit - dark), 0.0, "largest difference from the image without the light")


def _on() -> Measured:
    """A light in the plane of a square grazes it everywhere: it is as if it were not there."""
    renderer = _renderer("primitive/plane")
    lit, dark = _lit(renderer, 100.0, (0.05, 0.1, 0.0)), _lit(renderer, 0.0, (0, 0, 0))
    return Measured(largest(lit - dark), 0.0, "largest difference from the image without the light")


def _against_formula(
    mesh: str | tuple[Part, ...], thing: dict[str, Any], lamps: Lamps, spread: float = 1.0
) -> Measured:
    """Compares radiance and displayed values under any light, where the surface is flat, with their formula.

    `spread`: ratio of the measured value's relative rounding to that of a few float32 products.
    """
    lights = {
        "points": [{}] * len(lamps.points),
        "directional": [{}] * len(lamps.suns),
        "spots": [{"inner_angle": inner, "outer_angle": outer} for inner, outer in lamps.spots[:, 7:]],
    }
    scene = placed(mesh, size=(33, 33), camera={"azimuth": 0.4, "elevation": 0.3}, thing=thing, lights=lights)
    coordinates = [kind.copy() for kind in (lamps.points, lamps.suns, lamps.spots[:, :7])]
    for kind, unit in zip(coordinates, (30, 3, 30), strict=True):  # the group's units of energy
        kind[:, 0] /= unit
    light = [lamps.ambient, *(value for kind in coordinates for value in kind.ravel())]
    reference = expected(scene, lamps)
    what = "largest error of radiance (relative to the brightest) and of displayed values"
    what = f"{what}; {len(reference.pixels)} pixels"
    return Measured(formula_error(scene, reference, light), spread * FORMULA, what)


def _touching() -> Measured:
    """A light just above a square: white below it, and elsewhere in proportion to its height."""
    renderer = _renderer("primitive/plane", ambient=0.0)
    image = _lit(renderer, 1.0, (0.0, 0.0, 1e-4))
    need(bool((image[16, 16] > 1 - 1e-6).all()), "it is not white below the light")
    scene = placed("primitive/plane", size=(33, 33), camera=FRONT)
    light = [30.0, 0.0, 0.0, 1e-4]
    pixels = (33 * np.arange(10, 23)[:, None] + np.arange(10, 13)).ravel()
    reference = expected(scene, Lamps(0.0, np.array([light])), pixels)
    need(len(reference.pixels) == len(pixels), "a pixel is not flat")
    radiance, _ = radiance_at(renderer, reference.pixels, [0.0, 1.0, *light[1:]])
    error = largest(radiance / reference.radiance - 1)
    return Measured(error, 5 * FORMULA, "relative error of radiance, against the formula; the square lies in z = 0")


def _far(distance: float) -> Measured:
    """A far light is a parallel one, with the radiance of the formula."""
    energy = 30 * (distance / 3) ** 2
    lamp = np.array([[energy, 0.6 * distance, 0.3 * distance, 0.8 * distance]])
    return _against_formula("primitive/cube", {}, Lamps(0.1, lamp))


def _falls_off() -> Measured:
    """A light straight before a square, twice as far with four times the energy: the same in the middle, and there
    energy / (π d²) and the coat's reflectance straight on, F₀ / (4 π α²) of the irradiance."""
    renderer = _renderer("primitive/plane", ambient=0.0)
    worst = 0.0
    for energy, distance in ((1.0, 0.5), (4.0, 1.0), (16.0, 2.0), (1.0, 3.0)):
        radiance, _ = radiance_at(renderer, MIDDLE, [0.0, energy / 30, 0.0, 0.0, distance])
        reference = energy / distance**2 * (1 / pi + 0.04 / (4 * pi * 0.45**4))
        worst = max(worst, largest(radiance / reference - 1))
    return Measured(worst, FORMULA, "relative error of the middle's radiance at distances of 0.5 to 3, closed form")


def _sky(up: float) -> Measured:
    """Under the sky alone a white square that faces the camera at elevation `up` has 1 + sin(up) / 3 and its gloss."""
    camera = {"azimuth": 0.0, "elevation": up}
    scene = placed("primitive/plane", size=(33, 33), camera=camera, thing={"rotation": (-up, 0.0, 0.0)})
    radiance, _ = radiance_at(PyrenderRenderer(scene), MIDDLE, [0.7, 0.0, 0.0, 0.0, 3.0])
    reference = 0.7 * (1 + sin(up) / 3 + 0.04)
    return Measured(largest(radiance - reference), FORMULA, "error of the middle's radiance, closed form")


def _linear() -> Measured:
    """Radiance is linear in the light's energy from 1e-30 to 1e6, and at 30 it is that of the formula."""
    scene = placed("primitive/plane", size=(33, 33), camera=FRONT)
    reference = expected(scene, Lamps(0.0, np.array([[30.0, 1.0, 1.0, 3.0]])))
    renderer = _renderer("primitive/plane", ambient=0.0)
    worst = 0.0
    for energy in (1e-30, 1e6, 1.0):
        radiance, _ = radiance_at(renderer, reference.pixels, [0.0, energy, 1.0, 1.0, 3.0])
        worst = max(worst, largest(radiance / energy / reference.radiance - 1))
    return Measured(worst, FORMULA, "relative error of radiance per energy, against the formula")


def _strong() -> Measured:
    """A light that is far too strong makes its surface white, and one of ten times its energy the same white."""
    renderer = _renderer()
    first, second = _lit(renderer, 1e6, (0, 0, 3)), _lit(renderer, 1e7, (0, 0, 3))
    need(bool((first[16, 16] > 1 - 1e-6).all()), "the middle is not white")
    changed = largest(first[16, 16] - second[16, 16])
    return Measured(changed, 0.0, "change of the brightest pixel for ten times the energy")


def _refused(energy: float, position: tuple[float, float, float]) -> Measured:
    return Measured(float(_lit(_renderer(), energy, position).max()), -1.0, "brightest displayed value")


def light_cases() -> Iterator[Case]:
    """The cases of this family."""
    dark, formula = "as without the light", "radiance and image by the formula"
    points = [[30.0, 1.2, 2.0, 1.5], [8.0, -1.0, 0.2, 0.9], [90.0, 0.3, -2.5, 3.0], [2.0, 0.1, 1.0, 0.6]]
    suns = np.array([[2.0, -0.3, -1.0, -0.6], [1.0, 0.5, -0.2, -0.8]])
    spots = np.array(
        [[25.0, -1.0, 0.4, 1.5, 1.1, -0.3, -1.4, 0.1, 0.35], [40.0, 0.3, 1.6, 0.9, -0.5, -3.0, -1.5, 0.0, 0.5]]
    )
    four, all_kinds = Lamps(0.25, np.array(points)), Lamps(0.25, np.array(points[:1]), suns, spots)
    low = Lamps(0.0, np.array([[30.0, 2.0, 0.1, 0.02]]))
    colored: dict[str, Any] = {"color": (0.8, 0.35, 0.05)}
    turned = ("primitive/cube", colored | {"rotation": (0.5, -0.3, 0.2)})
    refused = "the job ends, and says that its numbers are not finite"
    terms, cone = "body, coat, sky and fall-off together", "directions of any length; a cone's edge"
    short = "interpolated normals of length 0.9"
    yield case("four lights on a coloured cube", terms, formula, _against_formula, *turned, four)
    yield case("suns and spots on a coloured cube", cone, formula, _against_formula, *turned, all_kinds, 3.0)
    yield case("smooth normals on large faces", short, formula, _against_formula, ball(0.6), colored, four, 5.0)
    yield case("grazing light", "0.5° above a square", formula, _against_formula, "primitive/plane", {}, low, 10.0)
    yield case("0.5 to 3 away", "1/d² from 4 to 1/9", "energy / d² and the gloss straight on", _falls_off)
    yield case("sky from above", "no other light", "1 + n_y / 3, and the gloss", _sky, 1.2)
    yield case("sky from below", "no other light", "1 + n_y / 3, and the gloss", _sky, -1.2)
    yield case("in the object's centre", "d·n < 0 all over; v and l opposite", dark, _light_inside, (0, 0, 0))
    yield case("just below the surface", "1e-3 deep", dark, _light_inside, (0, 0, FIT_RADIUS - 2e-3))
    yield case("opposite the viewer", "v + l = 0: no half vector", dark, _opposite)
    yield case("on the surface", "1/d² without end, n·l = 0", dark, _on)
    yield case("1e-4 above the surface", "1/d² = 1e8", "white below it, else the formula", _touching, held="clipped")
    yield case("1e4 away", "energy 3e8", formula, _far, 1e4)
    yield case("1e15 away", "d² beyond float32's digits", formula, _far, 1e15)
    yield case("1e25 away", "its energy beyond float32", refused, _far, 1e25, refusal="non-finite")
    yield case("energy of 1e-30 to 1e6", "36 orders of magnitude", "radiance is linear, and the formula's", _linear)
    yield case("energy of 3e7", "10,000 times white", "held at white", _strong, held="clipped")
    yield case("infinite energy", "not a number", refused, _refused, inf, (0, 0, 3), refusal="non-finite")
    yield case("NaN position", "not a number", refused, _refused, 1.0, (nan, 0, 3), refusal="non-finite")
    yield case("energy beyond float32", "1e39", refused, _refused, 1e39, (0, 0, 3), refusal="non-finite")


Place = tuple[float, float, float]
HARD = {"softness": 0.0, "resolution": 1024}
SIDE = 4.0
"""Half the side of the ground."""
EDGE = 0.03
"""Distance from a hard shadow's edge, at the ball, within which a pixel is not looked at: a few texels of the map."""


def _scene(
    balls: Sequence[tuple[Place, float]], place: Place, shadows: dict[str, Any] | None, size: tuple[int, int] = (72, 96)
) -> ResolvedScene:
    """Balls, by centre and radius, over a square ground in the plane y = 0, and one light without any other."""
    side = SIDE * 2**0.5 / FIT_RADIUS
    things: list[dict[str, Any]] = [{"mesh": "primitive/plane", "rotation": (-pi / 2, 0.0, 0.0), "scale": side}]
    things += [{"mesh": "primitive/sphere", "translation": at, "scale": r / FIT_RADIUS} for at, r in balls]
    return resolve(
        Scene.model_validate(
            {
                "camera": {"size": size, "azimuth": 0.4, "elevation": 1.1, "distance": 5.0},
                "objects": things,
                "lights": {"ambient": 0.0, "points": [{"position": place}], "environment": {"map": "uniform"}},
                "shadows": shadows,
            }
        ),
        library(),
    )


def _ground(scene: ResolvedScene, balls: Sequence[tuple[Place, float]]) -> tuple[Doubles, np.ndarray[Any, Any]]:
    """The ground's point behind each pixel's middle [H, W, 3], and whether no ball is before it."""
    height, width = scene.description.camera.size
    x = ((np.arange(width) + 0.5) * 2 / width - 1) / scene.projection[0, 0]
    y = (1 - (np.arange(height) + 0.5) * 2 / height) / scene.projection[1, 1]
    down, right = np.meshgrid(y, x, indexing="ij")
    rays = np.stack([right, down, -np.ones_like(right)], axis=-1) @ scene.view[:3, :3].T
    points = scene.eye - rays * (scene.eye[1] / rays[..., 1])[..., None]
    clear = (np.abs(points) < 0.95 * SIDE).all(axis=-1)
    for at, radius in balls:
        clear &= _beside(points, scene.eye - points, at) > radius + 2 * EDGE
    return points, clear


def _beside(points: Doubles, towards: Doubles, centre: Place) -> Doubles:
    """Distances of a centre from the lines from points [..., 3] to their ends `towards` [..., 3]; infinite beyond."""
    lengths = np.linalg.norm(towards, axis=-1)
    units = towards / lengths[..., None]
    along = ((np.array(centre) - points) * units).sum(axis=-1)
    off = np.linalg.norm(np.array(centre) - points - along[..., None] * units, axis=-1)
    return np.where((along > 0) & (along < lengths), off, np.inf)


def _passing(scene: ResolvedScene, moved: dict[str, torch.Tensor] | None = None) -> Doubles:
    """Share of the light that reaches each pixel [H, W]: radiance with shadows over that without; 1 where it is 0."""
    plain = replace(scene, description=scene.description.model_copy(update={"shadows": None}))
    shaded, lit = (
        PyrenderRenderer(variant, tolerance="exact").radiance(moved or {})[0, ..., 0].double().numpy()
        for variant in (scene, plain)
    )
    return np.where(lit > 0, shaded / np.where(lit > 0, lit, 1.0), 1.0)


def _balls(balls: Sequence[tuple[Place, float]], place: Place, move: float = 0.0, least: int = 40) -> Measured:
    """Share of the ground's pixels that are not wholly lit or dark as the balls' outlines require.

    `move`: displacement of the first ball along x when it is drawn, relative to its position in the scene.
    """
    scene = _scene(balls, (1.0, 2.0, 1.0), HARD)
    start = PyrenderRenderer(scene, tolerance="exact").initial()
    moved = {"translation": start["translation"][None], "illumination": start["illumination"][None]}
    moved["translation"][0, 1, 0] += move
    moved["illumination"][0, 2:] = torch.tensor(place)
    (at, radius), *others = balls
    there = [((at[0] + move, at[1], at[2]), radius), *others]
    points, clear = _ground(scene, there)
    off = np.min([_beside(points, np.array(place) - points, c) - r for c, r in there], axis=0)
    seen = _passing(scene, moved)
    umbra, lit = clear & (off < -EDGE), clear & (off > EDGE)
    need(int(umbra.sum()) >= least and int(lit.sum()) >= least, f"{umbra.sum()} pixels are dark and {lit.sum()} lit")
    wrong = (seen[umbra] > 1e-6).sum() + (np.abs(seen[lit] - 1) > 1e-6).sum()
    what = f"share of the ground's pixels that are wrong, of {umbra.sum()} dark and {lit.sum()} lit by the closed form"
    return Measured(float(wrong / (umbra.sum() + lit.sum())), 0.0, what)


def _shadow_inside() -> Measured:
    """No light from inside a closed object reaches the ground."""
    scene = _scene([((0.0, 0.6, 0.0), 0.4)], (0.0, 0.6, 0.1), {"resolution": 512})
    points, clear = _ground(scene, [((0.0, 0.6, 0.0), 0.4)])
    seen = _passing(scene)[clear & (np.abs(points[..., 0]) < 1.5)]
    need(len(seen) > 500, f"only {len(seen)} pixels are compared")
    return Measured(float(seen.max()), 0.0, "largest share of the light on the ground")


def _nothing(place: Place) -> Measured:
    """The image of the ground alone is the same to the bit as without shadows."""
    return Measured(largest(_passing(_scene([], place, {})) - 1), 0.0, "largest change of the light's share")


def _alone() -> Measured:
    """A ball in the air, seen from its lit side: its triangles shadow neither themselves nor their neighbours."""
    scene = _scene([((0.0, 1.0, 0.0), 0.6)], (1.0, 5.0, 2.0), {"softness": 0.0})
    alone = replace(scene, meshes=scene.meshes[1:], models=scene.models[1:])
    own = scene.description.model_copy(update={"objects": scene.description.objects[1:]})
    alone = replace(alone, description=own)
    with_and_without = [
        PyrenderRenderer(replace(alone, description=own.model_copy(update={"shadows": shadows})), tolerance="exact")
        for shadows in (own.shadows, None)
    ]
    images = [renderer.render({})[0] for renderer in with_and_without]
    changed = (images[0] - images[1]).abs().amax(dim=-1)
    return Measured(float(changed.max()), 2 / 255, "largest change of a displayed value to the image without shadows")


def _texels() -> Measured:
    """The torch renderer's visibility of each texel from the ground."""
    balls = [((0.2, 0.3, -0.1), 0.3)]
    scene = _scene(balls, (0.0, 3.0, 0.0), {"texel_samples": 1})
    gbuffer = rasterise(scene)
    points, clear = _ground(scene, balls)
    pixels = torch.from_numpy(clear.ravel()).nonzero()[:, 0]
    visible = visibility(scene, gbuffer.at(pixels))
    assert visible is not None
    points = points.reshape(-1, 3)[clear.ravel()]
    wrong = hidden = compared = 0
    for seen, way in zip(visible.numpy(), directions(16, 32).numpy(), strict=True):
        if way[1] <= 0:
            continue
        off = _beside(points, np.broadcast_to(100 * way, points.shape), balls[0][0]) - balls[0][1]
        sure = np.abs(off) > 0.01
        wrong += int((seen != np.where(off < 0, 0, WHOLE))[sure].sum())
        hidden, compared = hidden + int((off < 0).sum()), compared + int(sure.sum())
    need(hidden > 1000, f"only {hidden} pairs are hidden")
    return Measured(wrong / compared, 0.0, f"share of {compared:,} pairs of pixel and texel that are wrong")


def shadow_cases() -> Iterator[Case]:
    """The cases of this family."""
    shape = "dark or lit by the closed form"
    around = [((1.0, 0.4, 0.2), 0.2), ((-0.9, 0.4, 0.3), 0.2), ((0.2, 0.4, 1.1), 0.2), ((0.1, 1.6, 0.0), 0.2)]
    contact, steep = "contact: distance 0 to what it shades", "depth changes 20 times as fast as place"
    among, away = "inside their bounding sphere: six maps", "2 scene units from where it stood"
    standing, low, moving = [((0.0, 0.4, 0.0), 0.4)], [((-0.3, 0.3, 0.0), 0.3)], [((-1.0, 0.5, 0.0), 0.3)]
    yield case("a ball on the ground", contact, shape, _balls, standing, (1.5, 2.5, 1.0))
    yield case("light 3° above the ground", steep, shape, _balls, low, (3.5, 0.5, 0.4))
    yield case("light among the objects", among, shape, _balls, around, (0.1, 0.7, 0.0))
    yield case("an object moved out of the map", away, shape, _balls, moving, (3.0, 2.0, 0.5), move=2.0)
    yield case("a light 1e5 away", "float32 rays alike", shape, _balls, [((0.0, 0.5, 0.0), 0.4)], (8e4, 5e4, 3e4))
    yield case("light inside an object", "nothing gets out", "no light", _shadow_inside)
    yield case("no occluder", "an empty map", "as without shadows", _nothing, (1.0, 2.0, 1.0))
    yield case("no occluder, grazing", "1° above it", "as without shadows", _nothing, (3.0, 0.05, 0.3))
    yield case("a ball alone", "its triangles graze the light", "as without shadows", _alone)
    yield case("every texel over the ground", "contact, 512 directions", shape, _texels)
