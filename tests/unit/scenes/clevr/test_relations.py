"""Relations and pixel coordinates against the camera that draws the scene's description."""

import numpy as np
import pytest

from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import generate
from services.scenes.clevr.records import relationships
from services.scenes.view import camera_to_world, projection


@pytest.fixture(params=range(5))
def scene(request: pytest.FixtureRequest):
    return generate(11, request.param)


def test_relations_are_those_along_the_camera_s_axes(scene) -> None:
    description = describe(scene)
    pose = camera_to_world(description.camera)
    right, towards = pose[:3, 0], pose[:3, 2]
    away = -np.array([towards[0], 0.0, towards[2]]) / np.hypot(towards[0], towards[2])
    centres = np.array([one.translation for one in description.objects])
    for name, along in (("right", right), ("left", -right), ("behind", away), ("front", -away)):
        offsets = (centres[None] - centres[:, None]) @ along
        assert [list(row) for row in scene.relationships[name]] == [list(np.flatnonzero(row > 0.2)) for row in offsets]


def test_pixel_coordinates_are_the_projected_centres(scene) -> None:
    camera = describe(scene).camera
    world = np.array([[*one.translation, 1.0] for one in describe(scene).objects])
    seen = world @ np.linalg.inv(camera_to_world(camera)).T
    clip = seen @ projection(camera, 100.0).T
    for one, depth, point in zip(scene.objects, -seen[:, 2], clip, strict=True):
        x, y = point[:2] / point[3]
        assert one.pixel_coords[2] == pytest.approx(depth, rel=1e-12)
        assert abs(one.pixel_coords[0] - (x + 1) / 2 * 320) <= 0.5 + 1e-9
        assert abs(one.pixel_coords[1] - (1 - y) / 2 * 240) <= 0.5 + 1e-9


def test_directions_are_unit_vectors_in_the_plane_and_opposite(scene) -> None:
    for first, second in (("left", "right"), ("front", "behind"), ("above", "below")):
        along = np.array(scene.directions[first])
        assert np.linalg.norm(along) == pytest.approx(1)
        assert np.array_equal(along, -np.array(scene.directions[second]))


def test_objects_within_the_offset_are_unrelated() -> None:
    along = {"left": (1, 0, 0), "right": (-1, 0, 0), "front": (0, 1, 0), "behind": (0, -1, 0)}
    found = relationships([(0, 0, 0), (0.19, 0.21, 0)], along)
    assert found == {"left": [[], []], "right": [[], []], "front": [[1], []], "behind": [[], [0]]}
