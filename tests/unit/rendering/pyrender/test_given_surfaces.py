"""Objects and floors of a given metallic and roughness, against the BRDF in float64, and a floor against an object."""

from math import pi, sqrt
from typing import Any

import numpy as np
import pytest
import torch

from scene_attack.rendering.physical_change import physical_changes
from scene_attack.rendering.pyrender.planner import both_sides
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack_service.settings import Settings
from tests.unit.rendering import shapes

pytestmark = pytest.mark.slow

Array = np.ndarray
PLACE, ENERGY = (0.9, 1.6, 1.1), 9.0
SIDE = 3.0


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(Settings().cache_dir, tmp_path_factory.mktemp("data"))


def scene(
    *objects: dict[str, Any], floor: dict[str, Any] | None = None, size: tuple[int, int] = (60, 80), **more: Any
) -> Scene:
    light = {"ambient": 0.0, "points": [{"energy": ENERGY, "position": PLACE}], "environment": {"map": "uniform"}}
    camera = {"size": size, "azimuth": 0.4, "elevation": 0.5, "distance": 2.6}
    given = {"camera": camera, "lights": light, "objects": objects} | ({} if floor is None else {"floor": floor})
    return Scene.model_validate(given | more)


def ggx(points: Array, normals: Array, eye: Array, base: tuple[float, ...], metallic: float, roughness: float) -> Array:
    """Radiance [..., 3] under the point light, from the papers: D and the half vector of Walter et al. (2007), in terms
    of the tangent; F of Schlick (1994); the height-correlated G of Heitz (2014), which glTF's specification names.
    """
    to_light, to_eye = np.array(PLACE) - points, eye - points
    distance = np.linalg.norm(to_light, axis=-1, keepdims=True)
    l, v = to_light / distance, to_eye / np.linalg.norm(to_eye, axis=-1, keepdims=True)
    h = (l + v) / np.linalg.norm(l + v, axis=-1, keepdims=True)
    nl, nv, nh, vh = ((a * b).sum(-1, keepdims=True) for a, b in ((normals, l), (normals, v), (normals, h), (v, h)))
    color = np.array(base)
    f0 = 0.04 * (1 - metallic) + color * metallic
    fresnel = f0 + (1 - f0) * (1 - vh) ** 5
    alpha, tangent2 = roughness**2, 1 / nh**2 - 1
    facets = 1 / (pi * alpha**2 * nh**4 * (1 + tangent2 / alpha**2) ** 2)
    beneath = sum((np.sqrt(1 + alpha**2 * (1 / np.maximum(c, 1e-9) ** 2 - 1)) - 1) / 2 for c in (nl, nv))
    shadowing = 1 / (1 + beneath)
    gloss = facets * fresnel * shadowing / (4 * np.maximum(nl, 1e-9) * nv)
    body = (1 - fresnel) * 0.96 * (1 - metallic) * color / pi
    return np.asarray(ENERGY / distance**2 * np.maximum(nl, 0) * (body + gloss))


def at_the_ball(resolved: ResolvedScene, radius: float) -> tuple[Array, Array, Array]:
    """Points and normals [N, 3] of a ball about the origin at pixel centres, and which pixels: those well inside it."""
    eye, rays = shapes.rays(resolved.description.camera)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    along = -(rays @ eye)
    miss = np.linalg.norm(eye + along[..., None] * rays, axis=-1)
    seen = miss < 0.9 * radius
    points = eye + (along[seen] - np.sqrt(radius**2 - miss[seen] ** 2))[:, None] * rays[seen]
    return points, points / radius, seen


@pytest.mark.parametrize(("metallic", "roughness"), [(1.0, 0.3), (1.0, 0.6), (0.0, 0.7), (0.4, 0.45)])
def test_a_ball_has_the_radiance_of_the_brdf(library: Library, metallic: float, roughness: float) -> None:
    color = (0.9, 0.4, 0.1)
    ball = {"mesh": "primitive/sphere", "color": color, "metallic": metallic, "roughness": roughness}
    resolved = resolve(scene(ball, size=(240, 320)), library)
    points, normals, seen = at_the_ball(resolved, FIT_RADIUS)
    found = PyrenderRenderer(resolved, tolerance="exact").radiance({})[0].double().numpy()[seen][:, :3]
    wanted = ggx(points, normals, resolved.eye, color, metallic, roughness)
    assert seen.mean() > 0.1
    # Where facets meet, a pixel is shaded up to a quarter of it (0.004 radians of the ball) from its middle, and a
    # highlight falls off within alpha radians.
    errors, alpha = np.abs(found - wanted), roughness**2
    assert errors.mean() < 3e-3 / alpha * wanted.mean()
    assert errors.max() < 6e-3 / alpha * wanted.max()


def test_a_rough_plane_has_the_radiance_of_the_brdf(library: Library) -> None:
    """The floor, whose triangles reach far beyond the frame, where no object is: the small ball is above the frame's
    middle."""
    floor = {"size": 8.0, "height": -0.2, "metallic": 0.0, "roughness": 0.8, "color": (0.3, 0.5, 0.7)}
    ball = {"mesh": "primitive/sphere", "scale": 0.1}
    resolved = resolve(scene(ball, floor=floor), library)
    found = PyrenderRenderer(resolved, tolerance="exact").radiance({})[0].double().numpy()
    eye, rays = shapes.rays(resolved.description.camera)
    points = eye + rays * ((-0.2 - eye[1]) / rays[..., 1])[..., None]
    inside = (np.abs(points[..., (0, 2)]).max(axis=-1) < 3.9) & (rays[..., 1] < 0) & (found[..., 3] == 1)
    inside &= np.linalg.norm(np.cross(eye, rays), axis=-1) / np.linalg.norm(rays, axis=-1) > 0.1  # beside the ball
    assert inside.mean() > 0.75
    wanted = ggx(points, np.array([0.0, 1.0, 0.0]), eye, (0.3, 0.5, 0.7), 0.0, 0.8)
    errors = np.abs(found[inside][:, :3] / wanted[inside] - 1)
    assert (errors < 1e-4).mean() > 0.9
    # Along the diagonal each triangle is shaded up to a quarter pixel from the pixel's middle.
    assert errors.max() < 0.03


BALL = {"mesh": "primitive/sphere", "scale": 0.5, "translation": (0.1, -0.1, 0.2)}
FLOORS = [{}, {"metallic": 0.6, "roughness": 0.4}]
UNDER = {"size": SIDE, "height": -0.5, "color": (0.4, 0.5, 0.6)}
AS_OBJECT = {
    "mesh": "primitive/plane",
    "rotation": (-pi / 2, 0.0, 0.0),
    "scale": SIDE / (sqrt(2) * FIT_RADIUS),
    "translation": (0.0, -0.5, 0.0),
    "color": (0.4, 0.5, 0.6),
}


@pytest.mark.parametrize("surface", FLOORS, ids=["its own", "given"])
def test_a_floor_looks_like_the_same_square_as_an_object(library: Library, surface: dict[str, float]) -> None:
    floor = PyrenderRenderer(resolve(scene(BALL, floor=UNDER | surface), library), tolerance="exact")
    other = PyrenderRenderer(resolve(scene(BALL, AS_OBJECT | surface), library), tolerance="exact")
    one, two = floor.radiance({})[0], other.radiance({})[0]
    # Its corners are rounded to float32 in another space: a sample at an edge may fall to the other side.
    differ = (one - two).abs().amax(-1) > 1e-4 * two[..., :3].max()
    assert float(differ.float().mean()) < 2e-3
    assert float(one[..., 3].mean()) > 0.5


def test_groups_have_no_coordinate_of_the_floor(library: Library) -> None:
    plain, floored = (PyrenderRenderer(resolve(scene(BALL, BALL, floor=f), library)) for f in (None, UNDER))
    for group, value in plain.initial().items():
        assert floored.initial()[group].shape == value.shape
        assert floored.names(group) == plain.names(group)
    black = {"color": torch.zeros(1, 2, 3, dtype=torch.float64)}
    away = {"translation": torch.full((1, 2, 3), 40.0, dtype=torch.float64)}
    assert floored.radiance(away)[0, -1, :, 3].min() == 1  # the floor stays
    still = floored.exact().radiance(black)[0, -1] - floored.exact().radiance({})[0, -1]
    assert still.abs().max() == 0  # and keeps its colour
    perturbation = {"translation": torch.full((2, 3), 0.1, dtype=torch.float64)}
    assert len(physical_changes(resolve(scene(BALL, BALL, floor=UNDER), library), floored, perturbation)) == 2


@pytest.mark.usefixtures("software_opengl")
@pytest.mark.parametrize("camera", [False, True], ids=["its camera", "other cameras"])
def test_the_rasteriser_draws_given_surfaces_and_floors(library: Library, camera: bool) -> None:
    """Its error is of the size of that of other surfaces: samples at silhouettes, of which small images have many."""
    lit = {"ambient": 0.3, "points": [{"energy": ENERGY, "position": PLACE}, {"energy": 5, "position": (-1, 1, 1)}]}
    ball = {"mesh": "primitive/sphere", "color": (0.9, 0.6, 0.2), "metallic": 1.0, "roughness": 0.3, "scale": 0.5}
    cube = {"mesh": "primitive/cube", "roughness": 0.7, "scale": 0.4, "translation": (-0.6, -0.2, 0.3)}
    plain = {"mesh": "primitive/torus", "scale": 0.5, "translation": (0.5, 0.1, 0.4)}
    described = scene(ball, cube, plain, floor={"size": 30.0, "height": -0.4, "roughness": 0.9}, lights=lit)
    renderer = PyrenderRenderer(resolve(described, library), tolerance=0.02)
    assert renderer.rasterises
    batch = both_sides(renderer.initial(), ("illumination", "color", "translation", *(["camera"] if camera else [])))
    chosen = {group: value[-12:] if camera else value[::5] for group, value in batch.items()}
    off = (renderer.render(chosen) - renderer.exact().render(chosen)).abs().amax(-1)
    assert float(off.mean()) < 5e-4
    assert float((off > 1 / 255).float().mean()) < 0.015


def test_the_plan_names_floor_and_given_surfaces(library: Library) -> None:
    described = scene(BALL | {"metallic": 1.0}, BALL, floor=UNDER)
    items = {item.what: item for item in PyrenderRenderer(resolve(described, library)).plan.items}
    assert (items["parts with a given surface"].kept, items["parts with a given surface"].of) == (1, 3)
    assert items["faces"].part == "fixed"
    assert "parts with a given surface" not in {
        item.what for item in PyrenderRenderer(resolve(scene(BALL), library)).plan.items
    }


def test_a_camera_stays_above_the_floor(library: Library) -> None:
    low, high = PyrenderRenderer(resolve(scene(BALL, floor=UNDER), library)).bounds()["camera"]
    for distance in (float(low[2]), float(high[2])):
        assert distance * np.sin(float(low[1])) >= -0.5 - 1e-9
    assert float(low[1]) > -0.3
