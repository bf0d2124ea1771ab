"""Dents against scipy's splines, a mesh that is really dented, central differences, and their own limits."""

from collections.abc import Iterator
from math import atan, degrees, radians, tan
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import Tensor

import scene_attack as sa
from scene_attack.process import options
from scene_attack.rendering.physical_change import worded
from scene_attack.rendering.torch.bump import LARGEST, STEEPEST, UNIT, Bump, limited, raised
from scene_attack.rendering.torch.lattice import Lattice, Places
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS, Mesh
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.rendering import dents, shapes
from tests.unit.rendering.dents import NODES, SPACING, random_dents
from tests.unit.rendering.torch.drill import attacked

MATERIAL = {"material": "matte"}


def dented(resolved: ResolvedScene, tolerance: Any = "exact") -> TorchRenderer:
    return TorchRenderer(resolved, groups=("bump",), tolerance=tolerance)


def resolved(**scene: Any) -> ResolvedScene:
    used = options()
    described = sa.Scene.model_validate({"camera": {"size": (48, 48)}} | scene)
    return resolve(described, Library(used.cache_dir, used.data_dir))


def one(mesh: str = "primitive/torus", **thing: Any) -> ResolvedScene:
    return resolved(objects=[{"mesh": mesh} | MATERIAL | thing])


def in_its_frame(scene: ResolvedScene, bump: Bump, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the surfaces of object k, and their points in its frame, by the camera's matrices alone."""
    height, width = scene.description.camera.size
    own = (bump.shown.object_index == k).nonzero()[:, 0].numpy()
    pixels, depth = bump.shown.pixels.numpy()[own], bump.shown.depth.double().numpy()[own]
    x = (2 * (pixels % width) + 1) / width - 1
    y = 1 - (2 * (pixels // width) + 1) / height
    clip = np.stack([x * depth, y * depth, 0 * x, depth], axis=1)
    clip[:, 2] = scene.projection[2, 3] - depth * scene.projection[2, 2]
    world = clip @ np.linalg.inv(scene.projection @ np.linalg.inv(scene.view)).T
    local = world @ np.linalg.inv(scene.models[k]).T
    return own, local[:, :3] / local[:, 3:]


SEVERAL = {
    "objects": [
        {"mesh": "primitive/torus", "rotation": [0.4, -0.3, 1.0], "scale": 0.5, "translation": [-0.4, 0.1, 0.0]},
        {"mesh": "primitive/cube", "rotation": [0.0, 0.7, 0.0], "scale": 0.4, "translation": [0.4, 0.0, 0.2]},
    ]
}


@pytest.mark.parametrize("azimuth", [0.0, 2.2])
def test_heights_and_slopes_are_those_of_scipys_splines(azimuth: float) -> None:
    scene = resolved(**SEVERAL, camera={"size": (40, 56), "azimuth": azimuth})
    bump, values = dented(scene).bump, random_dents(2)
    heights, slopes = (of(torch.from_numpy(values)).numpy() for of in (bump.heights, bump.slopes))
    for k in range(2):
        own, points = in_its_frame(scene, bump, k)
        within = abs(points).max(axis=1) < FIT_RADIUS  # the middle of a pixel at an outline may be beside the object
        own, points = own[within], points[within]
        assert len(own) > 50
        turn = scene.view[:3, :3].T @ scene.models[k][:3, :3] / np.linalg.norm(scene.models[k][:3, 0])
        wanted = dents.gradient(points, values[k]) @ turn.T
        # The depths are float32: at 1e-7 of a place among waves of 0.1
        np.testing.assert_allclose(slopes[own], wanted, atol=1e-4)
        scale = 1000 / (2 * FIT_RADIUS)
        np.testing.assert_allclose(heights[own], scale * dents.height(points, values[k]), atol=1e-3)


def test_a_floor_has_no_dents() -> None:
    scene = resolved(objects=[{"mesh": "primitive/cube"} | MATERIAL], floor={"size": 6.0})
    bump, values = dented(scene).bump, torch.from_numpy(random_dents())
    of_floor = bump.shown.object_index == 1
    assert of_floor.sum() > 100
    assert not bump.slopes(values)[of_floor].any()
    assert not bump.heights(values)[of_floor].any()
    assert not bump.tilts(values)[of_floor].any()


# The normals against those of a mesh that is dented


def sphere_scene(coefficients: np.ndarray | None, amount: float) -> ResolvedScene:
    """A finely divided sphere, raised by `amount` of the dents, whose normals are its triangles'."""
    plain = shapes.sphere(0.8 * FIT_RADIUS, rings=360)
    vertices, normals = plain.vertices.astype(np.float64), plain.normals
    if coefficients is not None:
        units = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
        vertices = vertices + amount * dents.height(vertices, coefficients)[:, None] * units
        normals = vertex_normals(vertices, plain.faces)
    raised = shapes.part(vertices, plain.faces, normals)
    return shapes.placed(shapes.scene((96, 96)), Mesh((raised,), "0" * 64, None))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Of each vertex the sum of its triangles' normals by area; vertices at one place share theirs."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    _, at = np.unique(vertices.round(9), axis=0, return_inverse=True)
    sums = np.zeros((at.max() + 1, 3))
    for k in range(3):
        np.add.at(sums, at[faces[:, k]], across)
    normals = sums[at]
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_normals_are_those_of_the_dented_mesh_to_first_order() -> None:
    """At the points that OpenGL sees of the dented mesh, each compared with the point of the sphere that was raised to
    it, the error is of second order in the height: half the dents have a quarter of it. The waves are long beside a
    pixel, whose normal is the mean of its samples'."""
    turns = 2 * np.pi * 2.5 / (NODES - 3) * np.arange(NODES)
    coefficients = 10.0 * np.sin(np.add.outer(np.add.outer(turns, 0.7 * turns), 0.5 * turns))
    errors, sizes = [], []
    for amount in (2.0, 1.0, 0.5):
        scene = sphere_scene(coefficients, amount)
        bump = dented(scene).bump
        _, points = in_its_frame(scene, bump, 0)
        truth, inside = bump.shown.normals.double(), bump.shown.share == 1
        normals = torch.from_numpy(points / np.linalg.norm(points, axis=1, keepdims=True))
        slopes = at_points(0.8 * FIT_RADIUS * normals.numpy()).slopes(amount * torch.from_numpy(coefficients)[None])
        found = torch.nn.functional.normalize(raised(normals, slopes), dim=1)
        inside &= normals[:, 2] > 0.6
        errors.append(float((found - truth)[inside].norm(dim=1).mean()))
        sizes.append(float((truth - normals)[inside].norm(dim=1).mean()))
    assert sizes[0] > 0.16  # the largest dents turn normals by 9° in the mean
    orders = [np.log2(errors[k] / errors[k + 1]) for k in range(2)]
    assert min(orders) > 1.7, (errors, orders)  # 2, less what a pixel's mean and the mesh's triangles add


# Gradients


def objective(renderer: TorchRenderer, values: Tensor) -> Tensor:
    weights = torch.randn(1, *renderer.size, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return (renderer.render({"bump": values}) * weights).sum()


@pytest.mark.parametrize(
    "scene",
    [
        {"objects": [{"mesh": "primitive/torus"} | MATERIAL]},
        SEVERAL,
        {"objects": [{"mesh": "furniture/folding-chair", "material": "plastic"}], "floor": {"size": 6.0}},
        # a table's top that is seen from straight ahead: normals at the pole of the angles
        {"objects": [{"mesh": "primitive/cube", "translation": [0, -0.8, 0]} | MATERIAL], "camera": {"elevation": 0.0}},
    ],
)
def test_gradient_against_a_central_difference(scene: dict[str, Any]) -> None:
    camera = {"size": (32, 32), "azimuth": 0.3} | scene.get("camera", {})
    renderer = dented(resolved(**scene | {"camera": camera}))
    count = len(renderer.initial()["bump"])
    rng = torch.Generator().manual_seed(2)
    for start in (
        torch.zeros(1, count, NODES, NODES, NODES, dtype=torch.float64),
        torch.from_numpy(random_dents(count, 5, 3.0))[None],
        torch.from_numpy(random_dents(count, 5, 40.0))[None],  # dents that are limited
    ):
        direction = torch.randn(start.shape, dtype=torch.float64, generator=rng)
        leaf = start.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(objective(renderer, leaf), leaf)
        assert gradient.isfinite().all()
        h = 1e-5
        up, down = (objective(renderer, start + sign * h * direction) for sign in (1, -1))
        assert float((gradient * direction).sum()) == pytest.approx(float((up - down) / (2 * h)), rel=2e-5)


@pytest.mark.parametrize("with_gradient", [False, True])
def test_no_dents_are_the_scene_to_the_bit(with_gradient: bool) -> None:
    renderer = dented(one("primitive/sphere"))
    none = torch.zeros_like(renderer.initial()["bump"])[None].requires_grad_(with_gradient)
    assert torch.equal(renderer.render({"bump": none}).detach(), renderer.render({}))


def test_slopes_have_no_curl() -> None:
    """∂ᵢgⱼ = ∂ⱼgᵢ, by central differences of slopes at places a little apart: what is raised is a surface."""
    values, rng, step = random_dents(seed=7)[0], np.random.default_rng(0), 1e-5
    points = rng.uniform(-0.6, 0.6, (200, 3)) * FIT_RADIUS
    jacobian = np.empty((200, 3, 3))
    for axis in range(3):
        moved = [points + sign * step * np.eye(3)[axis] for sign in (1, -1)]
        up, down = (at_points(of).slopes(torch.from_numpy(values)[None]).numpy() for of in moved)
        jacobian[:, axis] = (up - down) / (2 * step)
    assert abs(jacobian).max() > 1
    assert abs(jacobian - jacobian.transpose(0, 2, 1)).max() / abs(jacobian).max() < 1e-6


def at_points(points: np.ndarray) -> Bump:
    """Surfaces at points [P, 3] of an object's frame that is the camera's."""
    bump = dented(one("primitive/sphere")).bump
    index = torch.zeros(len(points), dtype=torch.int64)
    places = Places.at(Lattice.of(0.1), torch.from_numpy(points), index, index == 0)
    turns = torch.eye(3, dtype=torch.float64).expand(len(points), 3, 3)
    return Bump(bump.shown, torch.zeros(len(points), 3, dtype=torch.float64), places, turns, turns)


# Limits, words and requests


def rough() -> Iterator[np.ndarray]:
    """Coefficients of one object that are as rough as they may be: random ones, a ridge, and single waves of many
    directions and lengths."""
    for seed in (1, 12, 27, 28):  # of thirty the steepest between the places where slopes are limited
        yield random_dents(seed=seed, largest=LARGEST)[0]
    ridge = np.full((NODES, NODES, NODES), -LARGEST)
    places = np.arange(NODES)
    ridge[np.add.outer(np.add.outer(places, places), places) > 33] = LARGEST
    yield ridge
    rng = np.random.default_rng(5)
    for _ in range(6):
        x, y, z = (turn * places for turn in rng.uniform(0.3, 2.0, 3))
        yield LARGEST * np.sign(np.sin(np.add.outer(np.add.outer(x, y), z) + rng.uniform(0, 3)))


def test_no_dents_are_steeper_or_higher_than_the_declared_range() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.99, 0.99, (30_000, 3)) * FIT_RADIUS
    most = []
    for given in rough():
        drawn = limited(torch.from_numpy(given)[None])[0].numpy()
        slopes = np.linalg.norm(dents.gradient(points, drawn), axis=1)
        most.append(degrees(atan(slopes.max())))
        assert abs(dents.height(points, drawn)).max() <= LARGEST * UNIT
        if not np.array_equal(drawn, given):
            assert most[-1] > 27  # no less than they may be
    assert max(most) <= 30
    assert sum(angle > 27 for angle in most) > 4
    declared = str(TorchRenderer.declaration.group("bump").natural_range)
    assert "30°" in declared
    assert f"{LARGEST:.0f} mm" in declared


def test_each_object_is_limited_by_its_own_dents() -> None:
    given = torch.from_numpy(random_dents(2, 1, 40.0))
    given[1] *= 0.3
    drawn = limited(given)
    assert torch.equal(drawn[1], given[1])
    # Sums over several objects at once may be added in another order than over one.
    torch.testing.assert_close(drawn[:1], limited(given[:1]), rtol=1e-12, atol=0.0)
    assert not torch.equal(drawn[0], given[0])


def test_one_dented_object_is_the_same_from_every_view() -> None:
    """At a point that two cameras see the dents turn the normal by the same angle in the world."""
    values = torch.from_numpy(random_dents(seed=4))
    seen = []
    for azimuth in (0.0, 0.5):
        scene = resolved(
            objects=[{"mesh": "primitive/sphere"} | MATERIAL], camera={"size": (96, 96), "azimuth": azimuth}
        )
        bump = dented(scene).bump
        _, points = in_its_frame(scene, bump, 0)
        world = bump.slopes(values).numpy() @ scene.view[:3, :3].T
        seen.append((points, world))
    distance, nearest = cKDTree(seen[1][0]).query(seen[0][0])
    near = distance < 0.1 * SPACING
    assert near.sum() > 200
    difference = np.linalg.norm(seen[0][1][near] - seen[1][1][nearest[near]], axis=1)
    assert np.median(difference) < 0.1 * np.median(np.linalg.norm(seen[0][1], axis=1))


@pytest.fixture
def result() -> sa.Result:
    return attacked("bump")


def test_a_result_says_its_dents_in_millimetres(result: sa.Result) -> None:
    [change] = result.record.change.things
    assert change.group == "bump"
    assert "mm" in change.sentence
    assert "slopes of up to" in change.sentence
    assert "at its size of" in change.sentence
    share = [value.after for value in change.values if value.unit == "%"]
    coefficients = result.perturbation["bump"]
    assert share == [pytest.approx(100 * float(abs(coefficients).max()) / LARGEST)]
    assert [image.file for image in change.images] == ["dents.png"]


def test_dents_have_no_u_unless_one_is_asked_for() -> None:
    assert sa.FGSM(renderer="torch", groups=["bump"]).truncation is None
    assert sa.FGSM(renderer="torch", groups=["bump", "normals"]).truncation == 18
    assert sa.FGSM(renderer="torch", groups=["bump"], truncation=18).truncation == 18


def test_words_are_of_each_objects_own_dents() -> None:
    """Of two objects, the first limited and the second of a known size, whatever its scale, by scipy's splines at the
    points that are seen; slopes are looked at in the whole lattice, at nodes and middles of cells."""
    scene = resolved(
        objects=[
            {"mesh": "primitive/torus", "translation": [-0.7, 0.0, 0.0]} | MATERIAL,
            {"mesh": "furniture/drill", "translation": [0.7, 0.0, 0.0], "rotation": [0.3, 0.5, 0.0], "scale": 0.8}
            | MATERIAL,
        ],
        camera={"size": (48, 64), "distance": 4.0},
    )
    renderer, given = dented(scene), random_dents(2, largest=LARGEST)
    given[1] *= 0.3
    along = np.linspace(-FIT_RADIUS, FIT_RADIUS, 2 * (NODES - 3) + 1)
    lattice = np.stack(np.meshgrid(along, along, along), axis=-1).reshape(-1, 3)
    assert scene.meshes[1].centimetres is not None
    units = 0.1, 2 * FIT_RADIUS * scene.meshes[1].centimetres / 100
    things = worded(scene, renderer, {"bump": torch.from_numpy(given)})
    for k, (thing, size) in enumerate(zip(things, units, strict=True)):
        own, points = in_its_frame(scene, renderer.bump, k)
        # the middle of a pixel at an outline may be beside the object
        points, drawn = points.clip(-FIT_RADIUS, FIT_RADIUS), limited(torch.from_numpy(given))[k].numpy()
        heights, slopes = size * dents.height(points, drawn) / UNIT, dents.gradient(points, drawn)
        normals = renderer.bump.shown.normals.double().numpy()[own] @ scene.models[k][:3, :3]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        across = slopes - (slopes * normals).sum(axis=1, keepdims=True) * normals
        used = np.linalg.norm(dents.gradient(lattice, given[k]), axis=1).max() / tan(radians(STEEPEST))
        assert [value.value for value in thing.sizes] == [
            pytest.approx(np.sqrt((heights**2).mean()), rel=1e-3),
            pytest.approx(heights[abs(heights).argmax()], rel=1e-3),
            pytest.approx(degrees(atan(np.linalg.norm(across, axis=1).max())), abs=0.02),
            pytest.approx(100 * min(used, 1), rel=1e-6),
        ]
    assert "at its size of 35 cm" in things[1].change.sentence


def test_bounds_are_the_largest_heights() -> None:
    renderer = dented(one())
    assert [float(end) for end in renderer.bounds()["bump"]] == [-LARGEST, LARGEST]
    assert [float(end) for end in renderer.bounds()["paint"]] == [-1, 1]
