"""The description of a CLEVR scene: its geometry in our world, its colours, its camera."""

from itertools import product
from math import cos, pi, radians, sin

import numpy as np
import pytest

from services.scenes.clevr import description
from services.scenes.clevr.description import describe, rig_of
from services.scenes.clevr.generator import generate
from services.scenes.clevr.records import RGB, CameraRecord, Rig
from services.scenes.primitives import primitive
from services.scenes.view import camera_to_world, model_matrix

SCENES = [generate(5, k) for k in range(12)]


def vertices(placed) -> np.ndarray:
    (part,) = primitive(placed.mesh.removeprefix("primitive/")).parts
    matrix = model_matrix(placed)
    return part.vertices @ matrix[:3, :3].T + matrix[:3, 3]


def test_objects_stand_on_the_floor_with_the_size_of_their_word() -> None:
    radius = {"small": 0.35, "large": 0.7}
    for scene in SCENES:
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True):
            points = vertices(placed)
            x, y, _ = one.coords_3d
            assert points[:, 1].min() == pytest.approx(0, abs=1e-5)
            height = 2 * radius[one.size] / (2**0.5 if one.shape == "cube" else 1)
            assert points[:, 1].max() == pytest.approx(height, rel=1e-4)
            # All fit into a circle in the plane, which they touch.
            assert np.hypot(points[:, 0] - x, points[:, 2] + y).max() == pytest.approx(radius[one.size], rel=2e-3)


def test_a_turn_of_a_cube_is_about_the_vertical_axis() -> None:
    one, placed = next(
        (one, placed)
        for scene in SCENES
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True)
        if one.shape == "cube"
    )
    half, angle = one.coords_3d[2], radians(one.rotation)
    x, y, _ = one.coords_3d
    found = vertices(placed)[:, [0, 2]] * (1, -1)
    for u, v in product((-half, half), repeat=2):
        corner = np.array([x + u * cos(angle) - v * sin(angle), y + u * sin(angle) + v * cos(angle)])
        assert np.linalg.norm(found - corner, axis=1).min() < 1e-4


def test_camera_and_lights_are_where_the_record_says() -> None:
    for scene in SCENES:
        described, rig = describe(scene), scene.rig
        x, y, z = rig.camera
        assert camera_to_world(described.camera)[:3, 3] == pytest.approx([x, z, -y])
        assert [light.position for light in described.lights.points] == [
            (a, c, -b) for a, b, c in (rig.key, rig.fill, rig.back)
        ]
        assert described.camera.size == (240, 320)
        # A lens of 35 mm before a sensor of 32 mm by 24 mm.
        assert np.tan(described.camera.field_of_view / 2) == pytest.approx(12 / 35)


def test_colours_are_clevr_s_as_linear_reflectances() -> None:
    for scene in SCENES:
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True):
            assert placed.color == pytest.approx([c / 255 for c in RGB[one.color]])


def test_metal_and_rubber_differ_in_each_renderer_s_terms() -> None:
    expected = {"rubber": (0.0, 0.7), "metal": (1.0, 0.4)}
    presets = {one.material: set() for scene in SCENES for one in scene.objects}
    for scene in SCENES:
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True):
            presets[one.material].add(placed.material)
            assert (placed.metallic, placed.roughness) == expected[one.material]
    assert len(presets["rubber"]) == len(presets["metal"]) == 1
    assert presets["rubber"] != presets["metal"]


def test_a_record_without_a_rig_gets_the_base_scene_s_from_its_own_side() -> None:
    for scene in SCENES:
        bare = scene.model_copy(update={"camera": None, "lights": None})
        rig, base = rig_of(bare), Rig()
        camera = np.array(rig.camera)
        assert camera[:2] / np.hypot(*camera[:2]) == pytest.approx(np.array(scene.directions["front"][:2]))
        assert rig.elevation == pytest.approx(base.elevation)
        assert rig.distance == pytest.approx(base.distance)
        # The lights turn with the camera.
        between = np.arctan2(rig.key[1], rig.key[0]) - np.arctan2(rig.camera[1], rig.camera[0])
        before = np.arctan2(base.key[1], base.key[0]) - np.arctan2(base.camera[1], base.camera[0])
        assert (between - before + pi) % (2 * pi) == pytest.approx(pi)


def test_the_floor_fills_the_frame_of_every_camera() -> None:
    x, y, z = Rig().camera
    for corner in product((-0.5, 0.5), repeat=3):
        position = (x + corner[0], y + corner[1], z + corner[2])
        scene = SCENES[0].model_copy(update={"camera": CameraRecord(position=position)})
        pose = camera_to_world(describe(scene).camera)
        for across in (-16 / 35, 16 / 35):
            ray = pose[:3, :3] @ np.array([across, 12 / 35, -1])
            assert ray[1] < 0
            floor = pose[:3, 3] - ray * pose[1, 3] / ray[1]
            assert abs(floor[[0, 2]]).max() < description.FLOOR_SIZE / 2
