"""The group `camera`: where it looks from, against scenes described with that camera, and by closed forms."""

from dataclasses import replace
from math import cos, inf, pi, sin, tan

import numpy as np
import pytest
import torch
from torch import Tensor

from scene_attack.rendering.opengl.camera import CameraMatrices
from scene_attack.rendering.pose import POLES, MovingCamera
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Floor, Lights, PointLight, SceneObject
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.view import NEAR, camera_to_world
from tests.unit.rendering.pyrender.rasterised_scenes import LIGHTS, rasterised, wrinkled
from tests.unit.rendering.shapes import mesh, placed, quad, scene, six_parts, sphere


def cube(**camera: float) -> ResolvedScene:
    return placed(scene((60, 80), lights=LIGHTS, **camera), six_parts())


def looking(renderer: PyrenderRenderer, *camera: float) -> Tensor:
    """The image [H, W, 3] from a camera at azimuth, elevation, distance and roll."""
    return renderer.render({"camera": torch.tensor([camera], dtype=torch.float64)})[0]


def test_it_starts_at_the_scenes_own_camera_to_the_bit() -> None:
    resolved = cube(azimuth=0.7, elevation=-0.3, distance=2.1, roll=0.4)
    assert MovingCamera(resolved).initial.tolist() == [0.7, -0.3, 2.1, 0.4]
    own = CameraMatrices.of(camera_to_world(resolved.description.camera), resolved.projection)
    found = MovingCamera(resolved).matrices(np.array([0.7, -0.3, 2.1, 0.4]))
    for name in ("clip_from_world", "eye", "forward"):
        np.testing.assert_array_equal(getattr(found, name), getattr(own, name))


@pytest.mark.parametrize("exact", [False, True])
def test_a_moved_camera_sees_what_a_scene_with_that_camera_shows(exact: bool) -> None:
    """To the bit: highlights too, which depend on the viewer. The other scene has the same far plane."""
    scenes = cube(), cube(azimuth=0.8, elevation=0.5, distance=2.4)
    start, other = (PyrenderRenderer(of, tolerance=1.0) for of in scenes)
    if exact:
        start, other = start.exact(), other.exact()
    assert not torch.equal(start.render({})[0], other.render({})[0])
    assert torch.equal(looking(start, 0.8, 0.5, 2.4, 0.0), other.render({})[0])


def test_where_a_point_is_seen_has_a_closed_form() -> None:
    """A small ball beside and above the origin, from cameras all around it."""
    x, y, size = 0.25, 0.35, 121
    description = scene((size, size), lights=Lights(ambient=1.0, points=()))
    away = description.model_copy(update={"objects": (SceneObject(mesh="primitive/a", translation=(x, y, 0.0)),)})
    renderer = PyrenderRenderer(placed(away, mesh(sphere(0.04, 24))))
    rows, columns = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
    focal = size / 2 / tan(description.camera.field_of_view / 2)
    for azimuth, elevation, distance, roll in (
        (0.0, 0.0, 1.8, 0.0),
        (0.5, 0.0, 1.8, 0.0),
        (0.0, 0.6, 1.8, 0.0),
        (0.0, 0.0, 2.5, 0.0),
        (0.0, 0.0, 1.8, 0.7),
        (-1.0, 0.9, 2.2, -2.0),
    ):
        camera = torch.tensor([[azimuth, elevation, distance, roll]], dtype=torch.float64)
        coverage = renderer.radiance({"camera": camera})[0, ..., 3].double()
        right = x * cos(azimuth)
        up = y * cos(elevation) - x * sin(azimuth) * sin(elevation)
        depth = distance - (x * sin(azimuth) * cos(elevation) + y * sin(elevation))
        rolled = right * cos(roll) + up * sin(roll), up * cos(roll) - right * sin(roll)
        # the ball's middle; perspective stretches it by far less than a tenth of a pixel
        column, row = ((coverage * of).sum() / coverage.sum() for of in (columns, rows))
        assert float(column) == pytest.approx(size / 2 + focal * rolled[0] / depth, abs=0.15)
        assert float(row) == pytest.approx(size / 2 - focal * rolled[1] / depth, abs=0.15)


def test_a_quarter_roll_turns_the_image_clockwise() -> None:
    renderer = PyrenderRenderer(placed(scene((64, 64), azimuth=0.3), mesh(quad(0.5, 0.2), sphere(0.3, 24))))
    turned, still = looking(renderer, 0.3, 0.0, 1.8, pi / 2), looking(renderer, 0.3, 0.0, 1.8, 0.0)
    clockwise, other = (still.rot90(k, (0, 1)) for k in (-1, 1))
    # samples in a pixel are not placed alike in a turned pixel: silhouettes differ, and the rest does by rounding
    assert float(((turned - clockwise).abs().amax(-1) > 1e-3).float().mean()) < 0.05
    assert float(((turned - other).abs().amax(-1) > 1e-3).float().mean()) > 0.05


def test_its_bounds_keep_objects_between_the_near_and_the_far_plane_and_away_from_the_poles() -> None:
    things = (SceneObject(mesh="primitive/a", translation=(0.3, 0.4, 0.0), scale=0.5),)
    description = scene().model_copy(update={"objects": things})
    low, high = PyrenderRenderer(placed(description, mesh(sphere(0.3)))).bounds()["camera"]
    radius, far = 0.5 + 0.5 * FIT_RADIUS, 50.0
    assert low.tolist() == pytest.approx([-inf, POLES - pi / 2, radius + NEAR, -inf])
    assert high.tolist() == pytest.approx([inf, pi / 2 - POLES, far - radius, inf])


@pytest.mark.parametrize(("elevation", "distance"), [(pi / 2, 1.8), (-pi / 2, 0.2), (1.55, 90.0)])
def test_a_scene_beyond_a_bound_starts_at_it(elevation: float, distance: float) -> None:
    """Its own camera is allowed, and nothing beyond it."""
    camera = MovingCamera(cube(elevation=elevation, distance=distance))
    low, high = camera.bounds
    assert ((low <= camera.initial) & (camera.initial <= high)).all()
    assert elevation in (float(low[1]), float(high[1]))
    assert distance in (float(low[2]), float(high[2]), 1.8)


def test_over_a_floor_it_stays_above_the_plane_from_near_and_from_far() -> None:
    """The steepest view from below the horizon is that from the farthest place."""
    under = scene((60, 80), elevation=0.5, distance=2.0).model_copy(update={"floor": Floor(size=10.0, height=-0.5)})
    low, high = MovingCamera(placed(under, six_parts())).bounds
    assert float(low[1]) < 0
    for distance in (float(low[2]), float(high[2])):
        assert distance * sin(float(low[1])) >= -0.5 - 1e-12


def test_it_is_attacked_only_if_it_is_named() -> None:
    assert "camera" not in PyrenderRenderer(cube()).plan.groups
    plan = PyrenderRenderer(cube(), PYRENDER.group_names).plan
    [coordinates] = [item for item in plan.items if item.what == "coordinates"]
    # one of the three lights is inside the cube
    assert (coordinates.kept, coordinates.of) == (1 + 2 * 4 + 3 * 3 + 4, 1 + 3 * 4 + 3 * 3 + 4)
    assert "camera" in " ".join(stage.method for stage in plan.stages)


def test_its_names_and_the_others_are_as_before() -> None:
    renderer = PyrenderRenderer(placed(scene(), mesh(sphere(0.5))))
    assert renderer.names("camera") == ["camera azimuth", "camera elevation", "camera distance", "camera roll"]
    assert renderer.groups[-1] == "camera"


def test_an_object_that_leaves_the_frame_is_told_by_the_present_camera() -> None:
    """Inactive coordinates are proved at the camera that an attack has come to, not at the scene's."""
    description = scene((24, 32), lights=Lights(ambient=0.3, points=(PointLight(),)))
    aside = description.model_copy(update={"objects": (SceneObject(mesh="primitive/a", translation=(0.5, 0.0, 0.0)),)})
    renderer = PyrenderRenderer(placed(aside, mesh(quad(0.1))))
    start = renderer.initial()
    behind = start | {"camera": torch.tensor([pi / 2, 0.0, 0.3, 0.0], dtype=torch.float64)}
    assert not renderer.out_of_frame(start, 0, 0.01, turned=False)
    assert renderer.out_of_frame(behind, 0, 0.01, turned=False)
    assert not renderer.radiance({group: value[None] for group, value in behind.items()}).any()
    assert {one.group for one in renderer.inactive(behind, {})} == {"illumination", "color", "translation", "rotation"}


@pytest.mark.usefixtures("software_opengl")
def test_the_rasteriser_has_an_eye_for_every_pass() -> None:
    """Cameras of one batch are drawn side by side; a highlight that another eye sees would be elsewhere."""
    description = scene((64, 64), lights=Lights(ambient=0.1, points=(PointLight(position=(0.5, 0.5, 1.5)),)))
    renderer = rasterised(placed(description, mesh(wrinkled(0, 40))))
    cameras = torch.tensor([[a, e, 1.9, r] for a, e, r in ((0, 0, 0), (1, 0.3, 0), (-1, -0.4, 1))]).double()
    together = renderer.render({"camera": cameras})
    for image, camera in zip(together, cameras, strict=True):
        assert torch.equal(image, renderer.render({"camera": camera[None]})[0])
    exact = renderer.exact().render({"camera": cameras})
    covered = (exact - torch.tensor(description.ground)).abs().amax(-1) > 0
    assert float((together - exact).abs().amax(-1)[covered].mean()) < 3e-3
    # drawn with the eye of the first camera, highlights are off by far more
    elsewhere = [renderer.radiance({"camera": camera[None]}) for camera in cameras]
    assert float((elsewhere[0] - elsewhere[1]).abs().mean()) > 1e-2


def test_watertight_surfaces_stay_so_from_every_side() -> None:
    resolved = replace(cube(), meshes=(mesh(wrinkled(1, 24)),))
    renderer = PyrenderRenderer(resolved)
    assert renderer.watertight
    cameras = torch.tensor([[a, e, 1.8, 0.0] for a in (0, 2, 4) for e in (-1.5, 0, 1.5)]).double()
    off = (renderer.render({"camera": cameras}) - renderer.exact().render({"camera": cameras})).abs().amax(-1)
    assert float((off > 1 / 255).float().mean()) < 0.02
