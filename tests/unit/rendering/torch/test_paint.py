"""Paint against scipy's splines, a mesh with painted vertices, central differences, and its own limits."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import scene_attack as sa
from scene_attack.process import options
from scene_attack.rendering.physical_change import worded
from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN
from scene_attack.rendering.torch.paint import PRINTABLE, cielab
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.rendering.torch.words import paint_image
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS, Mesh, MetallicRoughness, Part
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.rendering import paints, shapes
from tests.unit.rendering.dents import NODES
from tests.unit.rendering.paints import random_paint
from tests.unit.rendering.shading import sphere_gbuffer, sphere_scene
from tests.unit.rendering.torch.drill import attacked
from tests.unit.rendering.torch.planned import error, on_sphere, studio_map
from tests.unit.rendering.torch.test_bump import SEVERAL, in_its_frame

MATERIALS = ("matte", "plastic", "metal")


def resolved(**scene: Any) -> ResolvedScene:
    used = options()
    return resolve(
        sa.Scene.model_validate({"camera": {"size": (40, 56)}} | scene), Library(used.cache_dir, used.data_dir)
    )


def painting(scene: ResolvedScene, tolerance: Any = "exact") -> TorchRenderer:
    return TorchRenderer(scene, groups=("paint",), tolerance=tolerance)


@pytest.mark.parametrize("azimuth", [0.0, 2.2])
def test_colours_are_those_of_scipys_splines(azimuth: float) -> None:
    scene = resolved(**SEVERAL, camera={"size": (40, 56), "azimuth": azimuth})
    renderer, values = painting(scene), random_paint(2)
    own = renderer.paint.shown.base_color.double()
    colors = renderer.paint.colors(own, torch.from_numpy(values)).numpy()
    for k in range(2):
        entries, points = in_its_frame(scene, renderer.bump, k)
        within = abs(points).max(axis=1) < FIT_RADIUS  # the middle of a pixel at an outline may be beside the object
        entries, points = entries[within], points[within]
        assert len(entries) > 50
        wanted = paints.painted(points, own.numpy()[entries], values[k])
        assert abs(wanted - own.numpy()[entries]).max() > 0.2
        np.testing.assert_allclose(colors[entries], wanted, atol=1e-4)  # depths are float32


def test_a_floor_has_no_paint() -> None:
    scene = resolved(objects=[{"mesh": "primitive/cube", "material": "plastic"}], floor={"size": 6.0})
    paint = painting(scene).paint
    of_floor, own = paint.shown.object_index == 1, paint.shown.base_color.double()
    assert of_floor.sum() > 100
    changed = paint.colors(own, torch.from_numpy(random_paint())) != own
    assert not changed[of_floor].any()
    assert changed[~of_floor].all()


# Against a mesh whose vertices have the colours


def painted_sphere(values: np.ndarray | None, material: str) -> ResolvedScene:
    """A sphere, whose vertices are painted if `values` are given: OpenGL joins their colours linearly."""
    plain = shapes.sphere(0.8 * FIT_RADIUS, rings=90)
    vertices, own = plain.vertices.astype(np.float64), np.full((len(plain.vertices), 3), 0.4)
    colors = own if values is None else paints.painted(vertices, own, values)
    colored = np.concatenate([colors, np.ones((len(colors), 1))], axis=1).astype(np.float32)
    no_uv = np.zeros((len(vertices), 2), np.float32)
    surface = MetallicRoughness(
        metallic=0.0,
        roughness=1.0,
        emissive=(0.0, 0.0, 0.0),
        alpha_mode="OPAQUE",
        alpha_cutoff=0.5,
        double_sided=True,
        normal_scale=1.0,
        occlusion_strength=1.0,
        maps={},
        tangents=np.zeros((len(vertices), 4), np.float32),
        second_uv=no_uv,
        vertex_colors=colored,
    )
    return scene_of(replace(plain, uv=no_uv, metallic_roughness=surface), material)


def scene_of(part: Part, material: str) -> ResolvedScene:
    described = sa.Scene(
        camera=sa.Camera(size=(96, 96)), objects=[sa.Object(mesh="primitive/sphere", material=material)]
    )
    return shapes.placed(described, Mesh((part,), "0" * 64, None))


@pytest.mark.parametrize("material", MATERIALS)
def test_paint_draws_the_mesh_with_painted_vertices(material: str) -> None:
    """Paint is looked up at the middle of a pixel, and OpenGL's colours are means of its samples: both are second order
    in the pixel, under waves of 20 pixels. Outlines, where a pixel has few samples, are left out."""
    values = 0.9 * smooth()
    scene = painted_sphere(None, material)
    renderer, other = painting(scene), painting(painted_sphere(values, material))
    painted, wanted = renderer.render({"paint": torch.from_numpy(values)[None, None]})[0], other.render({})[0]
    shown = renderer.paint.shown
    facing = shown.normals.double() @ torch.from_numpy(scene.view[:3, 2])
    inside = shown.pixels[(shown.share == 1) & (facing > 0.3)]
    change = (wanted - renderer.render({})[0]).view(-1, 3)[inside]
    off = (painted - wanted).view(-1, 3)[inside].abs()
    assert change.abs().mean() > 0.05
    assert off.mean() < 0.008 * change.abs().mean()


def smooth() -> np.ndarray:
    """Coefficients [NODES, NODES, NODES, 3] of waves of half the size, other ones in each channel."""
    turns = 2 * np.pi * 2 / (NODES - 3) * np.arange(NODES)
    x, y, z = np.meshgrid(turns, turns, turns, indexing="ij")
    return np.sin(np.stack([x + 0.5 * y, y - 0.3 * z, 0.8 * z + 0.4 * x], axis=-1) + np.arange(3))


# The plan, the same bits and the gradient


@pytest.mark.parametrize("tolerance", ["exact", 1e-3])
@pytest.mark.parametrize("material", MATERIALS)
def test_no_paint_leaves_the_same_bits(material: str, tolerance: Any) -> None:
    renderer = on_sphere(("paint",), tolerance, size=48, materials=(material,))
    still = {"paint": renderer.initial()["paint"][None]}
    assert torch.equal(renderer.render(still), renderer.render({}))


@pytest.mark.parametrize("groups", [("paint",), ("paint", "normals"), ("paint", "illumination"), ("paint", "dials")])
@pytest.mark.parametrize("material", MATERIALS)
def test_the_plans_error_holds_for_all_paint(material: str, groups: tuple[str, ...]) -> None:
    """The sphere's own colour is dark: its errors show ten times as much where it is painted white."""
    scene = {"materials": (material,), "environment": None}
    renderer = on_sphere(groups, size=96, **scene)
    white, black = (torch.full((1, 1, NODES, NODES, NODES, 3), amount) for amount in (1.0, -1.0))
    for values in (white, black, torch.from_numpy(random_paint(seed=1)).float()[None]):
        assert 0 < error(renderer, {"paint": values}) <= renderer.plan.error <= 1e-3


def test_the_plan_is_made_for_the_lightest_colours() -> None:
    """A black surface has no lobe that shows, until it is painted."""
    plain = shapes.sphere(0.8 * FIT_RADIUS, rings=60)
    scene = scene_of(replace(plain, color=np.array([0, 0, 0, 1], np.float32)), "plastic")
    planned, plain = TorchRenderer(scene, groups=("paint",)), TorchRenderer(scene, groups=())
    kept = [{item.what: item.kept for item in one.plan.items} for one in (planned, plain)]
    assert kept[0]["lobes of the body"] > kept[1]["lobes of the body"]
    white = torch.ones(1, 1, NODES, NODES, NODES, 3)
    assert error(planned, {"paint": white}) <= planned.plan.error
    [stated] = planned.plan.gradients  # the gloss has no colour of the surface
    assert (stated.group, stated.part) == ("paint", "object 0 of the body")
    assert 0 < stated.relative < 1e-3


def test_a_table_is_checked_with_the_colours_that_are_painted() -> None:
    """The surface is black at first, and so is every error of its table. The table was measured without the sun."""
    groups = ("paint", "normals", "illumination")
    scene = sphere_scene((128, 128), studio_map(), ("brushed-metal",))
    renderer = TorchRenderer(scene, sphere_gbuffer(scene, albedo=(0, 0, 0)), groups, 3e-3)
    assert renderer.shaders[0].recipe.rows is not None
    start = {group: renderer.initial()[group][None] for group in groups}
    start["paint"] += 1
    assert error(renderer, start) <= renderer.plan.error
    assert renderer.failed_checks == 0
    start["illumination"][0, 6, 10] += 300 * ILLUMINATION_MEAN
    assert error(renderer, start) <= renderer.plan.error
    assert renderer.failed_checks == 1


@pytest.mark.parametrize(
    "scene",
    [
        SEVERAL,
        {"objects": [{"mesh": "furniture/folding-chair", "material": "plastic"}], "floor": {"size": 6.0}},
        {"objects": [{"mesh": "primitive/sphere", "material": "metal"}]},
    ],
)
def test_gradient_against_a_central_difference(scene: dict[str, Any]) -> None:
    renderer = painting(resolved(**scene | {"camera": {"size": (32, 32), "azimuth": 0.3}}))
    rng = torch.Generator().manual_seed(2)
    weights = torch.randn(1, *renderer.size, 3, dtype=torch.float64, generator=rng)
    count = len(renderer.initial()["paint"])

    def objective(values: Tensor) -> Tensor:
        return (renderer.render({"paint": values}) * weights).sum()

    # From the start, where the derivative is the mean of two sides, and elsewhere, where few shares are near 0.
    for start in (torch.zeros(1, count, NODES, NODES, NODES, 3), torch.from_numpy(random_paint(count, 5, 0.7))[None]):
        leaf = start.double().requires_grad_()
        (gradient,) = torch.autograd.grad(objective(leaf), leaf)
        direction = torch.randn(leaf.shape, dtype=torch.float64, generator=rng)
        step = 1e-5
        with torch.no_grad():
            difference = (objective(leaf + step * direction) - objective(leaf - step * direction)) / (2 * step)
        assert float((gradient * direction).sum()) == pytest.approx(difference.item(), rel=1e-4)


# Limits, words and requests


def test_painted_colours_are_printable_or_the_scenes_own() -> None:
    renderer = painting(resolved(objects=[{"mesh": "primitive/sphere", "material": "matte"}]))
    darkest, lightest = PRINTABLE
    assert (darkest, lightest) == (paints.DARKEST, paints.LIGHTEST)
    own = torch.linspace(0, 1, len(renderer.paint.places.first), dtype=torch.float64)[:, None].expand(-1, 3)
    for values in (torch.from_numpy(random_paint(seed=k)) for k in range(3)):
        colors = renderer.paint.colors(own, values)
        assert (colors >= own.clamp_max(darkest) - 1e-12).all()
        assert (colors <= own.clamp_min(lightest) + 1e-12).all()
    for amount, end in ((1.0, lightest), (-1.0, darkest)):
        colors = renderer.paint.colors(own, torch.full((1, NODES, NODES, NODES, 3), amount, dtype=torch.float64))
        torch.testing.assert_close(colors, torch.full_like(colors, end))


def test_the_printable_ends_are_lighter_and_darker_than_ink_on_paper() -> None:
    """ISO 12647-2 gives solid black L* 16 and coated paper L* 95."""
    ink, paper = (((lightness + 16) / 116) ** 3 for lightness in (16, 95))
    assert ink < PRINTABLE[0] < PRINTABLE[1] < paper


@pytest.mark.parametrize(
    ("srgb", "lab"),
    [  # known values: Lindbloom's calculator, D65
        ((1.0, 0.0, 0.0), (53.24, 80.09, 67.20)),
        ((0.0, 1.0, 0.0), (87.73, -86.18, 83.18)),
        ((0.0, 0.0, 1.0), (32.30, 79.19, -107.86)),
        ((1.0, 1.0, 1.0), (100.0, 0.0, 0.0)),
        ((0.002, 0.002, 0.002), (0.002 * (29 / 3) ** 3, 0.0, 0.0)),
    ],
)
def test_cielab_of_known_colours(srgb: tuple[float, ...], lab: tuple[float, ...]) -> None:
    found = cielab(torch.tensor(srgb, dtype=torch.float64))
    np.testing.assert_allclose(found.numpy(), lab, atol=0.05)


def test_a_result_says_its_paint_in_differences_of_colour() -> None:
    result = attacked("paint", steps=5)
    [change] = result.record.change.things
    values = {value.name.rpartition(", ")[2]: value.after for value in change.values}
    assert "ΔE" in change.sentence
    assert 0 < values["root mean square of the difference of colours"] < values["largest difference of colour"]
    assert values["share of the natural range"] == pytest.approx(100 * float(abs(result.perturbation["paint"]).max()))
    assert [image.file for image in change.images] == ["paint.png"]


def test_the_image_of_the_paint_shows_its_colours() -> None:
    renderer = painting(resolved(objects=[{"mesh": "primitive/sphere", "material": "metal"}]))
    white = torch.ones(1, NODES, NODES, NODES, 3, dtype=torch.float64)
    image = paint_image(renderer, white)
    shown = round(255 * (1.055 * PRINTABLE[1] ** (1 / 2.4) - 0.055))
    assert image[20, 28].tolist() == [shown] * 3
    assert image[0, 0].tolist() == [128] * 3


def test_paint_has_no_u_unless_one_is_asked_for() -> None:
    assert sa.FGSM(renderer="torch", groups=["paint"]).truncation is None


def test_words_are_of_the_colours_that_are_seen() -> None:
    scene = resolved(objects=[{"mesh": "primitive/torus", "material": "matte"}])
    renderer, values = painting(scene), random_paint(seed=2, largest=0.5)
    [thing] = worded(scene, renderer, {"paint": torch.from_numpy(values)})
    _, points = in_its_frame(scene, renderer.bump, 0)
    points = points.clip(-FIT_RADIUS, FIT_RADIUS)  # the middle of a pixel at an outline may be beside the object
    own = renderer.paint.shown.base_color.double().numpy()
    change = 100 * (paints.painted(points, own, values[0]) - own)
    *_, typical, largest, used = thing.sizes
    assert (typical.unit, largest.unit, used.unit) == ("% of white", "% of white", "%")
    wanted = np.sqrt((change**2).mean()), change.flat[abs(change).argmax()], 50
    assert [size.value for size in (typical, largest, used)] == pytest.approx(wanted, rel=1e-3)
