"""Shadow maps: where a shadow falls, in closed form; how soft it is; and what images of a batch share."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.declaration import BuildRequest
from scene_attack.rendering.opengl.shadows import FINER
from scene_attack.rendering.pyrender.planner import shadow_error
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import DirectionalLight, Lights, PointLight, SceneObject, Shadows, SpotLight
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering import shapes
from tests.unit.rendering.shadow_scenes import (
    CENTRE,
    RADIUS,
    ball,
    distance_to_line,
    ground_points,
    over_ground,
    square,
)

pytestmark = pytest.mark.slow

HARD = Shadows(softness=0.0, angle=0.0, resolution=1024)
PLACE = (1.2, 2.5, 1.0)
TEXELS = 3.0
"""Of the map on either side of a hard shadow's edge, within which it is not looked at."""


def passing(scene: ResolvedScene) -> np.ndarray:
    """The share of the only light that each pixel sees [H, W]: radiance with shadows over that without."""
    plain = over_plain(scene)
    shaded, lit = (
        PyrenderRenderer(one, tolerance="exact").radiance({})[0, ..., 0].double().numpy() for one in (scene, plain)
    )
    return np.where(lit > 0, shaded / np.maximum(lit, 1e-12), np.nan)


def over_plain(scene: ResolvedScene) -> ResolvedScene:
    """The scene without shadows."""
    return replace(scene, description=scene.description.model_copy(update={"shadows": None}))


def lights(kind: str) -> Lights:
    away = tuple(-x for x in PLACE)
    if kind == "point":
        return Lights(ambient=0.0, points=(PointLight(position=PLACE),))
    if kind == "directional":
        return Lights(ambient=0.0, points=(), directional=(DirectionalLight(direction=away),))
    return Lights(ambient=0.0, points=(), spots=(SpotLight(position=PLACE, direction=away, outer_angle=1.2),))


@pytest.mark.parametrize("kind", ["point", "directional", "spot"])
def test_a_ball_s_shadow_is_where_it_is(kind: str) -> None:
    """All or nothing of the light, but within a few texels of the edge."""
    scene = over_ground(ball(), shadows=HARD, lights=lights(kind), size=(96, 128), elevation=1.3)
    points, ground, _ = ground_points(scene)
    towards = np.broadcast_to(PLACE, points.shape) - (points if kind != "directional" else 0.0)
    off = distance_to_line(points, towards, CENTRE) - RADIUS
    seen = passing(scene)
    edge = TEXELS * 2 * 0.5 / 1024 * 3.0
    umbra, lit = ground & (off < -edge), ground & (off > edge)
    assert umbra.sum() > 50
    assert lit.sum() > 3000
    assert np.abs(seen[umbra]).max() == 0
    assert np.abs(seen[lit] - 1).max() < 1e-6


def test_a_light_among_the_objects_shadows_all_around() -> None:
    """Between balls on all sides, so that it needs the six sides of a cube."""
    place = np.array([0.1, 0.7, 0.0])
    centres = [
        np.array(c) for c in ((1.0, 0.4, 0.2), (-0.9, 0.4, 0.3), (0.2, 0.4, 1.1), (0.0, 0.4, -1.0), (0.1, 1.6, 0.0))
    ]
    light = Lights(ambient=0.0, points=(PointLight(position=tuple(place), energy=3.0),))
    scene = over_ground(*(ball(c, 0.2) for c in centres), shadows=HARD, lights=light, size=(96, 128), elevation=1.2)
    points, ground, eye = ground_points(scene)
    away = [distance_to_line(points, eye - points, c) > 0.22 for c in centres]
    ground &= np.all(away, axis=0)
    off = np.min([distance_to_line(points, place - points, c, whole=True) for c in centres], axis=0) - 0.2
    seen = passing(scene)
    umbra, lit = ground & (off < -0.02), ground & (off > 0.02)
    assert umbra.sum() > 300
    assert np.abs(seen[umbra]).max() == 0
    assert np.abs(seen[lit] - 1).max() < 1e-6


def test_a_penumbra_is_the_share_of_a_disc_above_an_edge() -> None:
    """Below the middle of a long edge: the part of the light's disc that the edge leaves, by the circle's segment."""
    height, radius, level = 3.0, 0.3, 1.0
    light = Lights(ambient=0.0, points=(PointLight(position=(0.0, height, 0.0), energy=30.0),))
    shadows = Shadows(softness=radius, samples=64, resolution=1024)
    roof = square(level, 0.8, (0.8, 0.0))  # its edge at x = 0
    scene = over_ground(roof, shadows=shadows, lights=light, size=(96, 128), elevation=0.5, azimuth=-pi / 2)
    points, _, eye = ground_points(scene)
    rays = points - eye
    at_roof = eye + rays * ((level - eye[1]) / rays[..., 1])[..., None]
    hidden = (at_roof[..., 0] > -0.02) & (at_roof[..., 0] < 1.62) & (np.abs(at_roof[..., 2]) < 0.82)
    half = radius * level / (height - level)
    u = points[..., 0] / half
    looked = ~hidden & (np.abs(points[..., 2]) < 0.3) & (np.abs(u) < 1.5)
    v = np.clip(u, -1, 1)
    wanted = 0.5 - (v * np.sqrt(1 - v**2) + np.arcsin(v)) / pi
    off = np.abs(passing(scene)[looked] - wanted[looked])
    assert looked.sum() > 80
    assert off.mean() < 0.015
    assert off.max() < 0.06


def test_a_shadow_begins_at_the_contact() -> None:
    """A square on edge that stands on the ground: its shadow starts within two texels of it."""
    wall = (shapes.mesh(shapes.quad(0.5)), SceneObject(mesh="primitive/plane", translation=(0.0, 0.5, 0.0)))
    light = Lights(ambient=0.0, points=(), directional=(DirectionalLight(direction=(0.0, -1.0, 1.0)),))
    scene = over_ground(wall, shadows=Shadows(resolution=512), lights=light, size=(96, 128), azimuth=0.0)
    points, ground, _ = ground_points(scene)
    seen = passing(scene)
    shadow = ground & (np.abs(points[..., 0]) < 0.4) & (points[..., 2] > 0.01) & (points[..., 2] < 0.9)
    assert shadow.sum() > 100
    assert seen[shadow].max() < 1e-6


def test_surfaces_without_anything_before_them_are_lit_as_without_shadows() -> None:
    """A ball alone, and the ground alone, under grazing light: no surface shadows itself."""
    low = Lights(ambient=0.0, points=(PointLight(position=(3.0, 0.15, 0.4)),))
    ground = over_ground(shadows=HARD, lights=low)
    off = passing(ground)
    assert np.nanmax(np.abs(off - 1)) == 0
    alone = shapes.placed(
        shapes.scene((64, 64)).model_copy(update={"shadows": Shadows(), "lights": lights("point")}),
        shapes.mesh(shapes.sphere(0.5, rings=96)),
    )
    images = [PyrenderRenderer(one, tolerance="exact").render({})[0] for one in (alone, over_plain(alone))]
    assert float((images[0] - images[1]).abs().max()) < 2 / 255


def test_images_of_a_batch_are_those_drawn_alone() -> None:
    """Lights, colours and poses that differ and agree in all ways, more of them than are drawn at once."""
    both = Lights(
        ambient=0.1,
        points=(PointLight(position=PLACE), PointLight(position=(-1.5, 2.0, 0.5), energy=12.0)),
        directional=(DirectionalLight(),),
    )
    scene = over_ground(ball(), shadows=Shadows(resolution=256, samples=4), lights=both, size=(24, 32))
    renderer = PyrenderRenderer(scene)
    assert not renderer.rasterises
    start = renderer.initial()
    rows = [{name: value.clone() for name, value in start.items()} for _ in range(14)]
    for k, row in enumerate(rows):
        if k % 3 == 1:
            row["illumination"][1 + k % 12] += 0.05
        if k % 4 == 2:
            row["translation"][1, k % 3] += 0.03
        if k % 5 == 3:
            row["color"][k % 2, k % 3] *= 0.5
    batch = {name: torch.stack([row[name] for row in rows]) for name in start}
    together = renderer.render(batch)
    alone = torch.cat([renderer.render({name: value[None] for name, value in row.items()}) for row in rows[::-1]]).flip(
        0
    )
    assert torch.equal(together, alone)
    exact = renderer.exact().render(batch)
    assert float((together - exact).abs().max()) < 1e-6
    assert len({image.numpy().tobytes() for image in together}) > 8


def test_an_object_out_of_the_frame_still_casts_its_shadow() -> None:
    """So it is no inactive coordinate, as it would be without shadows."""
    over = np.array([0.0, 1.9, 0.0])
    light = Lights(ambient=0.1, points=(PointLight(position=(0.0, 4.0, 0.0), energy=40.0),))
    scene = over_ground(ball(over, 0.3), lights=light, elevation=0.2, distance=3.0)
    renderer, plain = PyrenderRenderer(scene, tolerance="exact"), PyrenderRenderer(over_plain(scene), tolerance="exact")
    assert renderer.out_of_frame(renderer.initial(), 1, 0.05, turned=True)
    without = {(one.group, one.index) for one in plain.inactive(plain.initial(), {"translation": 0.05})}
    found = {(one.group, one.index) for one in renderer.inactive(renderer.initial(), {"translation": 0.05})}
    assert ("translation", 3) in without
    assert found == {one for one in without if one[0] not in ("translation", "rotation")}
    away = renderer.initial()["translation"].clone()
    away[1, 0] += 5.0
    assert float((renderer.render({}) - renderer.render({"translation": away[None]})).abs().max()) > 0.1


def test_differences_of_a_shadow_are_steady_in_their_step() -> None:
    """Central differences of a smooth functional of the ground's image in a light's and an object's place: texels that
    come and go leave them within a few percent of those at ten times the step."""
    size = (192, 256)
    scene = over_ground(ball(), shadows=Shadows(softness=0.15), lights=lights("point"), size=size)
    renderer = PyrenderRenderer(scene, tolerance="exact")
    rows, columns = torch.meshgrid(torch.linspace(0, 3, size[0]), torch.linspace(0, 2, size[1]), indexing="ij")
    ground = torch.tensor(ground_points(scene)[1])
    weights = (torch.sin(2 * rows + 1) * torch.cos(3 * columns) * ground)[..., None]
    start = renderer.initial()
    for group, place, steps, within in (
        ("illumination", (2,), (2e-2, 2e-3), 0.04),
        ("translation", (1, 0), (5e-2, 5e-3), 0.2),
    ):
        slopes = []
        for step in steps:
            sides = start[group].repeat(2, *[1] * start[group].ndim)
            sides[(0, *place)] += step
            sides[(1, *place)] -= step
            up, down = (renderer.radiance({group: sides})[..., :3].double() * weights).sum(dim=(1, 2, 3))
            slopes.append(float(up - down) / (2 * step))
        assert slopes[1] == pytest.approx(slopes[0], rel=within)


def test_too_large_maps_are_refused() -> None:
    many = Lights(points=(PointLight(),) * 4, directional=(DirectionalLight(),) * 4)
    scene = over_ground(ball(), shadows=Shadows(resolution=4096), lights=many)
    with pytest.raises(InvalidRequest, match="GiB") as refused:
        PyrenderRenderer.build(BuildRequest(scene, ("illumination",), 1e-3, None))
    assert refused.value.field == "scene.shadows.resolution"


def test_the_plan_says_which_objects_are_in_the_maps_and_what_the_maps_leave_out() -> None:
    """The ground is in no map. Fewer texels and samples leave out more."""
    errors = []
    for shadows in (
        Shadows(softness=0.2, resolution=64, samples=2),
        Shadows(softness=0.2, resolution=1024, samples=16),
    ):
        renderer = PyrenderRenderer(over_ground(ball(), shadows=shadows, lights=lights("point")))
        [item] = [item for item in renderer.plan.items if item.what == "shadow casters"]
        assert (item.kept, item.of) == (1, 2)
        [stage] = [stage for stage in renderer.plan.stages if stage.name == "shadow maps"]
        assert stage.evaluations == shadows.resolution**2
        [drawn] = [item for item in renderer.plan.items if item.what == "passes through OpenGL"]
        assert "it draws no shadows" in drawn.why
        errors.append(float(stage.why.split("displayed values by ")[1].split()[0]))
    assert 0 < errors[1] < errors[0] / 2
    plain = PyrenderRenderer(over_ground(ball(), shadows=None, lights=lights("point")))
    assert not any("shadow" in stage.name for stage in plain.plan.stages)


def test_the_error_of_shadows_is_the_mean_over_covered_pixels() -> None:
    """Of three covered pixels one is off by 0.3 in one channel; what is not covered does not count."""
    own, finer = torch.zeros(2, 2, 3), torch.zeros(2, 2, 3)
    finer[0, 1, 2], finer[1, 1] = 0.3, 1.0
    covered = torch.tensor([[True, True], [True, False]])
    assert shadow_error(own, finer, covered) == pytest.approx(0.3 / 9)
    assert shadow_error(own, finer, torch.zeros(2, 2, dtype=torch.bool)) == 0


def test_the_plan_s_error_is_that_of_the_displayed_images() -> None:
    """As images of two scenes show it, one with four times the texels and samples."""
    coarse = over_ground(ball(), shadows=Shadows(softness=0.2, resolution=64, samples=2), lights=lights("point"))
    fine = Shadows(softness=0.2, resolution=64 * FINER, samples=2 * FINER**2)
    finer = replace(coarse, description=coarse.description.model_copy(update={"shadows": fine}))
    own, wanted = (PyrenderRenderer(one, tolerance="exact") for one in (coarse, finer))
    covered = own.radiance({})[0, ..., 3] > 0
    expected = float((own.render({}) - wanted.render({}))[0].abs()[covered].double().mean())
    [stage] = [stage for stage in own.plan.stages if stage.name == "shadow maps"]
    assert expected > 1e-3
    assert f"by {expected:.1e} in the mean" in stage.why
