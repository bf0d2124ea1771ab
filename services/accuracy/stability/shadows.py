"""Shadows against closed forms: at a contact, under grazing light, with lights among and inside objects, and without
anything to cast them."""

from collections.abc import Sequence
from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import torch

from services.accuracy.placing import library
from services.accuracy.stability.case import Case, Measured, need
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.rendering.torch_renderer.light import directions
from services.rendering.torch_renderer.surfaces import WHOLE, visibility
from services.scenes.description import Scene
from services.scenes.mesh import FIT_RADIUS, Doubles
from services.scenes.resolve import ResolvedScene, resolve

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
    """The share of the light that each pixel sees [H, W]: with shadows over without; 1 where there is none without."""
    plain = replace(scene, description=scene.description.model_copy(update={"shadows": None}))
    shaded, lit = (
        PyrenderRenderer(one, tolerance="exact").radiance(moved or {})[0, ..., 0].double().numpy()
        for one in (scene, plain)
    )
    return np.where(lit > 0, shaded / np.where(lit > 0, lit, 1.0), 1.0)


def _balls(balls: Sequence[tuple[Place, float]], place: Place, move: float = 0.0, least: int = 40) -> Measured:
    """The share of the ground's pixels whose light is not all or nothing, as the balls' outlines say. `move`: how far
    the first ball is moved along x when it is drawn, from where it stands in the scene."""
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


def _inside() -> Measured:
    """Of a light inside a closed object nothing reaches the ground."""
    scene = _scene([((0.0, 0.6, 0.0), 0.4)], (0.0, 0.6, 0.1), {"resolution": 512})
    points, clear = _ground(scene, [((0.0, 0.6, 0.0), 0.4)])
    seen = _passing(scene)[clear & (np.abs(points[..., 0]) < 1.5)]
    need(len(seen) > 500, f"only {len(seen)} pixels are compared")
    return Measured(float(seen.max()), 0.0, "largest share of the light on the ground")


def _nothing(place: Place) -> Measured:
    """The ground alone has the bits that it has without shadows."""
    return Measured(
        float(np.abs(_passing(_scene([], place, {})) - 1).max()), 0.0, "largest change of the light's share"
    )


def _alone() -> Measured:
    """A ball in the air, seen from its lit side: its triangles shadow neither themselves nor their neighbours."""
    scene = _scene([((0.0, 1.0, 0.0), 0.6)], (1.0, 5.0, 2.0), {"softness": 0.0})
    one = replace(scene, meshes=scene.meshes[1:], models=scene.models[1:])
    own = scene.description.model_copy(update={"objects": scene.description.objects[1:]})
    one = replace(one, description=own)
    with_and_without = [
        PyrenderRenderer(replace(one, description=own.model_copy(update={"shadows": shadows})), tolerance="exact")
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
    found = visibility(scene, gbuffer.at(pixels))
    assert found is not None
    points = points.reshape(-1, 3)[clear.ravel()]
    wrong = hidden = compared = 0
    for seen, way in zip(found.numpy(), directions(16, 32).numpy(), strict=True):
        if way[1] <= 0:
            continue
        off = _beside(points, np.broadcast_to(100 * way, points.shape), balls[0][0]) - balls[0][1]
        sure = np.abs(off) > 0.01
        wrong += int((seen != np.where(off < 0, 0, WHOLE))[sure].sum())
        hidden, compared = hidden + int((off < 0).sum()), compared + int(sure.sum())
    need(hidden > 1000, f"only {hidden} pairs are hidden")
    return Measured(wrong / compared, 0.0, f"share of {compared:,} pairs of pixel and texel that are wrong")


def cases() -> list[Case]:
    """The cases of this family."""
    family, shape = "shadows", "dark or lit by the closed form"
    around = [((1.0, 0.4, 0.2), 0.2), ((-0.9, 0.4, 0.3), 0.2), ((0.2, 0.4, 1.1), 0.2), ((0.1, 1.6, 0.0), 0.2)]
    return [
        Case(
            "a ball on the ground",
            family,
            "contact: distance 0 to what it shades",
            shape,
            lambda: _balls([((0.0, 0.4, 0.0), 0.4)], (1.5, 2.5, 1.0)),
        ),
        Case(
            "light 3° above the ground",
            family,
            "depth changes 20 times as fast as place",
            shape,
            lambda: _balls([((-0.3, 0.3, 0.0), 0.3)], (3.5, 0.5, 0.4)),
        ),
        Case(
            "light among the objects",
            family,
            "inside their bounding sphere: six maps",
            shape,
            lambda: _balls(around, (0.1, 0.7, 0.0)),
        ),
        Case(
            "an object moved out of the map",
            family,
            "2 scene units from where it stood",
            shape,
            lambda: _balls([((-1.0, 0.5, 0.0), 0.3)], (3.0, 2.0, 0.5), move=2.0),
        ),
        Case(
            "a light 1e5 away",
            family,
            "float32 rays alike",
            shape,
            lambda: _balls([((0.0, 0.5, 0.0), 0.4)], (8e4, 5e4, 3e4)),
        ),
        Case("light inside an object", family, "nothing gets out", "no light", _inside),
        Case("no occluder", family, "an empty map", "as without shadows", lambda: _nothing((1.0, 2.0, 1.0))),
        Case("no occluder, grazing", family, "1° above it", "as without shadows", lambda: _nothing((3.0, 0.05, 0.3))),
        Case("a ball alone", family, "its triangles graze the light", "as without shadows", _alone),
        Case("every texel over the ground", family, "contact, 512 directions", shape, _texels),
    ]
