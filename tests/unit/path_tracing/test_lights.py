"""The unit and the place of each kind of light, and the sky, on a sphere whose radiance is known in closed form."""

from typing import Any

import numpy as np
import pytest

from scene_attack.scenes.description import DirectionalLight, Lights, PointLight, Shadows, SpotLight
from tests.unit.path_tracing.agreement import MODEL, assert_agree, averaged, images, inside, tracer, values_of
from tests.unit.rendering import shadow_scenes, shapes
from tests.unit.rendering.pyrender import closed_form

pytestmark = pytest.mark.slow


RADIUS = 0.5
COLOR = 0.6
PLACE = (0.8, 1.2, 1.6)
DIRECTION = (-0.5, -0.7, -0.6)
TERMINATOR = 0.1
"""Cosine of light and normal below which the triangles of the sphere hide light that its normals do not."""
ALLOWED = 0.001
"""Difference that is no disagreement, as a share of the brightest: triangles are in the sphere's place."""

Reference = Any


def irradiated(points: np.ndarray, normals: np.ndarray, eye: np.ndarray, to: np.ndarray, strength: Any) -> np.ndarray:
    """Radiance of the sphere's surface under light of irradiance `strength` from unit vectors `to`, coat included."""
    far = points + 1e6 * to  # as of a point light far away, whose energy makes up for the distance
    body, coat = (1e12 * part for part in closed_form.body_and_coat(points, normals, eye, far))
    result: np.ndarray = strength * (COLOR * body + coat)
    return result


def point(points: np.ndarray, normals: np.ndarray, eye: np.ndarray) -> np.ndarray:
    body, coat = closed_form.body_and_coat(points, normals, eye, PLACE)
    return 9.0 * (COLOR * body + coat)


def directional(points: np.ndarray, normals: np.ndarray, eye: np.ndarray) -> np.ndarray:
    towards = -np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    return irradiated(points, normals, eye, np.broadcast_to(towards, points.shape), 3.0)


def spot(points: np.ndarray, normals: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """KHR_lights_punctual: the fall-off is the square of a ramp in the cosine of the angle from the axis."""
    away = points - np.array(PLACE)
    cosine = away @ np.array(DIRECTION) / (np.linalg.norm(away, axis=-1) * np.linalg.norm(DIRECTION))
    ramp = np.clip((cosine - np.cos(0.3)) / (np.cos(0.1) - np.cos(0.3)), 0, 1)
    return ramp**2 * point(points, normals, eye)


AXIS = {"position": PLACE, "direction": DIRECTION}
LIGHTS: dict[str, tuple[dict[str, Any], Reference]] = {
    "point": ({"points": (PointLight(energy=9.0, position=PLACE),)}, point),
    "directional": ({"directional": (DirectionalLight(energy=3.0, direction=DIRECTION),)}, directional),
    "spot": ({"spots": (SpotLight(energy=9.0, inner_angle=0.1, outer_angle=0.3, **AXIS),)}, spot),
}


@pytest.mark.parametrize("kind", LIGHTS)
def test_a_light_s_unit_and_place(name: str, kind: str) -> None:
    lights, reference = LIGHTS[kind]
    description = shapes.scene((48, 48), lights=Lights(**{"ambient": 0.0, "points": ()} | lights))
    scene = shapes.placed(description, shapes.mesh(shapes.sphere(RADIUS)))
    drawn = images(tracer(name, scene), color=[[COLOR] * 3])
    expected, whole = averaged(description.camera, RADIUS, reference)
    lit = averaged(description.camera, RADIUS, lambda p, n, _: (n * (np.array(PLACE) - p)).sum(-1))[0]
    if kind == "directional":
        lit = averaged(description.camera, RADIUS, lambda _, n, __: n @ -np.array(DIRECTION))[0]
    where = inside(whole, drawn[0, ..., 3]) & (lit > TERMINATOR)
    allowed = max(ALLOWED, MODEL[name]) * expected[where].max()
    assert_agree(drawn[..., :3], expected[..., None].repeat(3, axis=-1), allowed, where)


def test_the_sky_is_brighter_above(name: str) -> None:
    """The body alone: of the coat no closed form is known, and its albedo is between 0.03 and 0.1 where it is seen from
    less than 75° off."""
    description = shapes.scene((48, 48), lights=Lights(ambient=0.7, points=()))
    scene = shapes.placed(description, shapes.mesh(shapes.sphere(RADIUS)))
    white, black = (images(tracer(name, scene), color=[[level] * 3])[..., :3] for level in (1.0, 0.0))
    body, whole = averaged(description.camera, RADIUS, lambda _, n, __: 0.7 * closed_form.sky(n[..., 1]))
    facing = averaged(description.camera, RADIUS, lambda p, n, e: closed_form_cosine(p, n, e))[0]
    where = inside(whole) & (facing > 0.25)
    assert_agree(white - black, body[..., None].repeat(3, axis=-1), 0.01, where)
    assert 0.03 * 0.7 < black[:, where].mean() < 0.1 * 0.7


def closed_form_cosine(points: np.ndarray, normals: np.ndarray, eye: np.ndarray) -> np.ndarray:
    to_eye = eye - points
    result: np.ndarray = (normals * to_eye).sum(-1) / np.linalg.norm(to_eye, axis=-1)
    return result


def test_a_lamp_is_not_seen(name: str) -> None:
    """One with a size, in front of the ground: a pixel that no object covers is empty."""
    lights = Lights(ambient=0.0, points=(PointLight(energy=9.0, position=(0.5, 0.5, 0.0)),))
    description = shapes.scene((48, 48), lights=lights).model_copy(update={"shadows": Shadows(softness=0.2)})
    scene = shapes.placed(description, shapes.mesh(shapes.sphere(0.2)))
    drawn = images(tracer(name, scene))
    rim = averaged(description.camera, 0.22, lambda p, _, __: p[..., 0])[1]
    assert drawn[:, rim].any()
    corner = drawn[:, :16, 32:]  # the lamp, of 0.2 about (0.5, 0.5), is in the middle of it
    assert not corner.any()


@pytest.mark.parametrize("kind", LIGHTS)
def test_a_light_s_size_keeps_its_unit(name: str, kind: str) -> None:
    """A large light lights a surface that faces it as a small one does. A disc of radius r at distance d is weaker by
    (r/d)², a sphere by half of that: 1 % here."""
    lights = Lights(**{"ambient": 0.0, "points": ()} | LIGHTS[kind][0])
    means = []
    for size in (0.0, 0.2):
        description = shapes.scene((32, 32), lights=lights)
        shadows = None if size == 0 else {"softness": size, "angle": size}
        description = type(description).model_validate(description.model_dump() | {"shadows": shadows})
        scene = shapes.placed(description, shapes.mesh(shapes.sphere(0.1)))
        drawn = images(tracer(name, scene, samples=256), color=[[1.0] * 3])
        means.append(drawn[..., :3].mean())
    assert means[1] == pytest.approx(means[0], rel=0.02)


def test_the_penumbra_of_parallel_light_is_as_wide_as_its_disc(name: str) -> None:
    """Beside the straight edge of a level square's shadow, the ground has the share of the disc that is seen there."""
    height, half, angle = 0.8, 0.7, 0.2
    lights = Lights(ambient=0.0, points=(), directional=(DirectionalLight(energy=3, direction=(0, -1, 0)),))
    view = {"azimuth": 0.0, "elevation": 0.6, "distance": 4.0}
    radiances = []
    for things in ((shadow_scenes.square(height, half),), ()):
        scene = shadow_scenes.over_ground(*things, shadows=Shadows(angle=angle), lights=lights, **view)
        own = tracer(name, scene, samples=256)
        radiances.append(own.trace(own.frame(values_of(own, {})))[..., 0])
    eye, rays = shapes.rays(scene.description.camera)
    ground, above = (eye + rays * ((y - eye[1]) / rays[..., 1])[..., None] for y in (0, height))
    beyond = (ground[..., 2] - half) / (height * np.tan(angle))
    beside = (abs(beyond) < 0.9) & (abs(ground[..., 0]) < 0.4) & (above[..., 2] > half + 0.05)
    share = (np.arccos(-beyond[beside]) + beyond[beside] * np.sqrt(1 - beyond[beside] ** 2)) / np.pi
    assert beside.sum() > 10
    assert abs(radiances[0][beside] / radiances[1][beside] - share).mean() < 0.03
