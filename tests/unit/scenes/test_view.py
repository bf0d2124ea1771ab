"""Cameras, poses and whether an object is in the frame, against projections worked out by hand."""

from math import cos, pi, sin, tan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scene_attack.scenes.description import Camera, SceneObject
from scene_attack.scenes.mesh import FIT_RADIUS, Mesh, Part
from scene_attack.scenes.primitives import primitive
from scene_attack.scenes.view import NEAR, camera_to_world, model_matrix, projection, rotation_matrix, visible_area

SIZE = (200, 300)


def clip(camera, placed=None, far=50.0):
    placed = placed or SceneObject(mesh="x")
    return projection(camera, far) @ np.linalg.inv(camera_to_world(camera)) @ model_matrix(placed)


def triangles(points, faces=None):
    points = np.asarray(points, np.float32).reshape(-1, 3)
    faces = np.arange(len(points)).reshape(-1, 3) if faces is None else np.asarray(faces)
    return Mesh((Part(points, np.zeros_like(points), faces.astype(np.int32)),), "", None)


@given(st.floats(-6, 6), st.floats(-pi / 2, pi / 2), st.floats(0.1, 50))
def test_the_camera_stands_where_it_should_and_looks_at_the_origin(azimuth, elevation, distance):
    pose = camera_to_world(Camera(azimuth=azimuth, elevation=elevation, distance=distance))
    place = distance * np.array([sin(azimuth) * cos(elevation), sin(elevation), cos(azimuth) * cos(elevation)])
    assert np.allclose(pose[:3, 3], place)
    assert np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3))
    assert np.isclose(np.linalg.det(pose[:3, :3]), 1)
    assert np.allclose(pose[:3, 3] - distance * pose[:3, 2], 0, atol=1e-12)
    assert pose[1, 1] >= -1e-12, "up is up"
    assert abs(pose[1, 0]) < 1e-12, "the horizon is level"


@settings(deadline=None)
@given(st.floats(-6, 6), st.floats(-pi / 2, pi / 2), st.floats(-6, 6))
def test_roll_turns_the_camera_about_its_line_of_sight_to_its_left(azimuth, elevation, roll):
    level, rolled = (camera_to_world(Camera(azimuth=azimuth, elevation=elevation, roll=r)) for r in (0.0, roll))
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0, 0, roll]).as_matrix()
    assert np.allclose(rolled, level @ turn, atol=1e-12)


def test_a_camera_without_roll_is_written_as_before_there_was_any():
    assert "roll" not in Camera().model_dump()
    assert Camera(roll=0.5).model_dump()["roll"] == 0.5


def test_the_projection_has_the_field_of_view_and_square_pixels():
    camera = Camera(field_of_view=0.8, size=(100, 250))
    top = projection(camera, 50.0) @ [0, tan(0.4) * 3, -3, 1]
    assert np.isclose(top[1] / top[3], 1)
    right = projection(camera, 50.0) @ [tan(0.4) * 3 * 2.5, 0, -3, 1]
    assert np.isclose(right[0] / right[3], 1)
    near, far = (projection(camera, 50.0) @ [0, 0, -z, 1] for z in (NEAR, 50.0))
    assert np.isclose(near[2] / near[3], -1)
    assert np.isclose(far[2] / far[3], 1)


def test_the_model_matrix_scales_then_rotates_then_moves():
    placed = SceneObject(mesh="x", scale=2, rotation=(0, 0, pi / 2), translation=(5, 0, 0))
    assert np.allclose(model_matrix(placed) @ [1, 0, 0, 1], [5, 2, 0, 1])


def test_the_area_of_a_facing_square_is_exact():
    camera = Camera(azimuth=0, elevation=0, distance=2, field_of_view=1.0, size=SIZE)
    side = 0.2
    square = triangles(np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * side / 2, [(0, 1, 2), (0, 2, 3)])
    pixels = side / (2 * tan(0.5) * 2) * SIZE[0]
    assert np.isclose(visible_area(square, clip(camera), SIZE, 1e9), pixels**2, rtol=1e-6)


def test_what_leaves_the_frame_counts_with_what_is_inside():
    camera = Camera(azimuth=0, elevation=0, distance=2, field_of_view=1.0, size=SIZE)
    huge = triangles(np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * 50, [(0, 1, 2), (0, 2, 3)])
    assert np.isclose(visible_area(huge, clip(camera), SIZE, 1e9), SIZE[0] * SIZE[1], rtol=1e-9)
    half = clip(camera) @ model_matrix(SceneObject(mesh="x", translation=(50, 0, 0)))
    assert np.isclose(visible_area(huge, half, SIZE, 1e9), SIZE[0] * SIZE[1] / 2, rtol=1e-9)


def test_a_floor_that_passes_under_the_camera_is_cut_at_the_near_plane():
    camera = Camera(azimuth=0, elevation=0, distance=2, field_of_view=1.0, size=SIZE)
    floor = triangles(
        np.array([(-9, -1, 9), (9, -1, 9), (9, -1, -9), (-9, -1, -9)]) * [10, 0.5, 10], [(0, 1, 2), (0, 2, 3)]
    )
    area = visible_area(floor, clip(camera, far=1e4), SIZE, 1e9)
    # Up to its far edge, 0.5 below the eye at a distance of 92: all of the lower half but a thin strip.
    strip = 0.5 / (92 * tan(0.5)) * SIZE[0] / 2 * SIZE[1]
    assert np.isclose(area, SIZE[0] * SIZE[1] / 2 - strip, rtol=1e-6)


@pytest.mark.parametrize(
    "translation",
    [(0, 0, 10), (0, 0, 2.7), (100, 0, 0), (0, 3, 0), (0, -3, 0), (-4, 0, 0), (3, 3, 0)],
)
def test_what_is_behind_or_beside_the_camera_has_no_area(translation):
    camera = Camera(azimuth=0, elevation=0, size=SIZE)
    placed = SceneObject(mesh="x", translation=translation)
    assert visible_area(primitive("sphere"), clip(camera, placed), SIZE, 1.0) == 0


def test_a_sphere_around_the_camera_fills_the_frame():
    camera = Camera(azimuth=0.3, elevation=0.2, distance=0.5, size=SIZE)
    assert visible_area(primitive("sphere"), clip(camera), SIZE, 1e9) == pytest.approx(SIZE[0] * SIZE[1], rel=1e-6)


def test_both_sides_of_a_sphere_count():
    camera = Camera(azimuth=0.3, elevation=0.2, distance=50, size=SIZE)
    radius = FIT_RADIUS / 50 / tan(camera.field_of_view / 2) * SIZE[0] / 2
    # Orthographic at that distance to (FIT_RADIUS / 50)² ≈ 2e-4; facets take some of the disk.
    assert visible_area(primitive("sphere"), clip(camera, far=100), SIZE, 1e9) == pytest.approx(
        2 * pi * radius**2, rel=2e-3
    )


@given(st.integers(0, 2**32 - 1))
def test_the_area_agrees_with_counting_pixel_centres(seed):
    rng = np.random.default_rng(seed)
    camera = Camera(azimuth=0, elevation=0, distance=1, field_of_view=1.2, size=(64, 64))
    points = rng.uniform(-1.5, 1.5, (3, 3)).astype(np.float32)
    to_clip = clip(camera)
    area = visible_area(triangles(points), to_clip, (64, 64), 1e9)
    # Independent of any clipping: a pixel's ray meets the triangle at a depth beyond the near plane.
    y, x = np.mgrid[63:-64:-2, -63:64:2] / 64 * tan(0.6)
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    eye = np.array([0.0, 0.0, 1.0])
    system = np.stack(
        [np.broadcast_to(points[1] - points[0], rays.shape), np.broadcast_to(points[2] - points[0], rays.shape), -rays],
        axis=-1,
    )
    if abs(np.linalg.det(system)).min() < 1e-7:
        return
    b, c, depth = np.linalg.solve(system, (eye - points[0])[None, :, None])[..., 0].T
    covered = ((b >= 0) & (c >= 0) & (b + c <= 1) & (depth > NEAR)).sum()
    # Pixel centres miss the area by at most the pixels that the outline crosses: up to 4 edges of up to 91 pixels.
    assert abs(area - covered) <= 0.5 * 4 * 91
    if area == 0:
        assert covered == 0


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-9, 1e-3, 1.0, pi, 2 * pi, 100.0])
def test_rotations_are_those_of_another_library(size):
    vectors = np.random.default_rng(0).normal(size=(5, 3))
    vectors = size * vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    found = rotation_matrix(vectors)
    np.testing.assert_allclose(found, Rotation.from_rotvec(vectors).as_matrix(), rtol=0, atol=1e-13 * max(1.0, size))
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), rtol=0, atol=1e-14)
