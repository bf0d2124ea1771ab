"""Normals against closed forms: a sphere's are its points, a cylinder's are radial, a box has three at a corner."""

from math import pi

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scene_attack.scenes.reading.normals import CREASE_ANGLE, smooth_normals


def arrays(mesh):
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def unwelded(vertices, faces):
    return vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


def turned(faces, share, seed=0):
    flip = np.random.default_rng(seed).random(len(faces)) < share
    return np.where(flip[:, None], faces[:, ::-1], faces)


def face_normals(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    return cross / np.linalg.norm(cross, axis=1, keepdims=True)


@pytest.mark.parametrize("weld", [True, False])
def test_a_sphere_has_its_points_as_normals(weld):
    vertices, faces = arrays(trimesh.creation.icosphere(4))
    if not weld:
        vertices, faces = unwelded(vertices, faces)
    out = smooth_normals(vertices, faces)
    # Triangles are 0.07 radians wide: averaging around a vertex leaves an error of second order, 0.07² / 2.
    assert np.abs(out.normals - vertices[out.source]).max() < 2.5e-3
    if not weld:
        flat = face_normals(vertices, faces)
        assert np.abs(np.repeat(flat, 3, axis=0) - vertices).max() > 0.02, "flat shading would be ten times worse"


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_faces_wound_against_their_neighbours_are_turned_over(share):
    vertices, faces = arrays(trimesh.creation.icosphere(3))
    mixed = turned(faces, share)
    # Pin the majority: the area-weighted winding decides which side is out.
    out = smooth_normals(vertices, mixed)
    side = np.sign((out.normals * vertices[out.source]).sum(axis=1))
    assert (side == side[0]).all()
    assert np.abs(out.normals * side[0] - vertices[out.source]).max() < 5e-3
    assert np.allclose(
        np.sign((face_normals(vertices, out.source[out.faces]) * out.normals[out.faces[:, 0]]).sum(1)), 1
    )
    if share == 0.3:
        assert side[0] == 1, "most faces were wound outwards"


def test_one_face_that_is_wrong_does_not_turn_the_others():
    vertices, faces = arrays(trimesh.creation.icosphere(2))
    for wrong in (0, 1, len(faces) - 1):
        mixed = faces.copy()
        mixed[wrong] = mixed[wrong, ::-1]
        out = smooth_normals(vertices, mixed)
        assert ((out.normals * vertices[out.source]).sum(axis=1) > 0.9).all()


def test_a_box_keeps_its_edges():
    vertices, faces = arrays(trimesh.creation.box())
    out = smooth_normals(vertices, faces)
    assert len(out.normals) == 24
    assert np.allclose(np.sort(np.abs(out.normals), axis=1), [0, 0, 1])


def test_a_cylinder_is_round_at_its_side_and_flat_at_its_ends():
    vertices, faces = arrays(trimesh.creation.cylinder(radius=1, height=3, sections=36))
    out = smooth_normals(vertices, faces)
    points = vertices[out.source]
    at_side = np.abs(out.normals[:, 2]) < 0.5
    radial = points[at_side] * [1, 1, 0]
    # Angle weights see each quadrilateral's right angle, so the mean is exactly radial for any diagonal.
    assert np.abs(out.normals[at_side] - radial).max() < 1e-6
    assert np.allclose(out.normals[~at_side], np.sign(points[~at_side, 2:]) * [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(("degrees", "split"), [(35.0, False), (45.0, True)])
def test_the_crease_angle_decides(degrees, split):
    slope = np.deg2rad(degrees)
    vertices = np.array([(0, 0, 0), (0, 1, 0), (-1, 0, 0), (np.cos(slope), 0, -np.sin(slope))], np.float64)
    out = smooth_normals(vertices, np.array([(0, 1, 2), (1, 0, 3)]))
    assert len(out.normals) == (6 if split else 4)
    assert np.isclose(CREASE_ANGLE, 40 * pi / 180)
    if not split:
        half = np.array([np.sin(slope / 2), 0, np.cos(slope / 2)])
        assert np.allclose(out.normals[:2], half, atol=1e-12)


def test_degenerate_and_repeated_faces_are_dropped():
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (0, 0, 0)], np.float64)
    faces = np.array([(0, 1, 2), (0, 1, 3), (0, 0, 1), (2, 1, 4), (1, 2, 0)])
    out = smooth_normals(vertices, faces)
    assert out.kept.tolist() == [0]
    assert np.allclose(out.normals, [0, 0, 1])


def test_nothing_is_left_of_a_mesh_without_area():
    out = smooth_normals(np.zeros((3, 3)), np.array([(0, 1, 2)]))
    assert len(out.faces) == len(out.normals) == 0


def test_a_seam_keeps_two_vertices_and_one_normal():
    # Two coplanar triangles that share an edge in space but not in their vertices, as at a texture seam.
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0.2), (1, 0, 0), (0, 1, 0), (1, 1, 0.2)], np.float64)
    out = smooth_normals(vertices, np.array([(0, 1, 2), (4, 6, 5)]))
    assert sorted(out.source.tolist()) == [0, 1, 2, 4, 5, 6]
    normal = {int(s): n for s, n in zip(out.source, out.normals, strict=True)}
    assert np.allclose(normal[1], normal[4])
    assert np.allclose(normal[2], normal[5])
    assert not np.allclose(normal[1], normal[0])


def test_a_shelf_against_a_wall_does_not_crease_the_wall():
    # Three faces at one edge: two coplanar ones and one that stands on them.
    vertices = np.array([(0, 0, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0), (0, 0, 1)], np.float64)
    for faces in ([(0, 1, 2), (0, 3, 1), (0, 1, 4)], [(0, 1, 2), (0, 1, 4), (0, 3, 1)]):
        out = smooth_normals(vertices, np.array(faces))
        # The wall's two faces share both vertices of the edge, the shelf has its own: 4 + 3.
        assert len(out.normals) == 7
        assert {tuple(n) for n in np.round(np.abs(out.normals), 9)} == {(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)}


def test_a_non_orientable_band_has_normals_everywhere():
    n = 40
    t = np.arange(n) * 2 * pi / n
    across = np.stack([np.cos(t / 2) * np.cos(t), np.cos(t / 2) * np.sin(t), np.sin(t / 2)], axis=1) * 0.3
    middle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    vertices = np.concatenate([middle - across, middle + across])
    k = np.arange(n)
    low, high = np.where(k + 1 < n, k + 1, n), np.where(k + 1 < n, k + 1 + n, 0)
    faces = np.concatenate([np.stack([k, low, high], 1), np.stack([k, high, k + n], 1)])
    out = smooth_normals(vertices, faces)
    assert len(out.faces) == 2 * n
    assert np.allclose(np.linalg.norm(out.normals, axis=1), 1)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(3, 30),
    st.integers(1, 60),
    st.floats(1e-3, 1e3),
)
def test_any_soup_gives_unit_normals_on_the_side_of_its_faces(seed, points, count, scale):
    rng = np.random.default_rng(seed)
    vertices = rng.integers(-3, 4, (points, 3)) * scale
    faces = rng.integers(0, points, (count, 3))
    out = smooth_normals(vertices.astype(np.float64), faces)
    assert np.isfinite(out.normals).all()
    assert np.allclose(np.linalg.norm(out.normals, axis=1), 1)
    assert len(out.faces) == len(out.kept)
    # Each face is one of the input, over or as it was.
    assert (np.sort(out.source[out.faces], axis=1) == np.sort(faces[out.kept], axis=1)).all()
    if len(out.faces):
        assert out.faces.max() == len(out.source) - 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_normals_turn_with_the_mesh_and_ignore_the_order_of_faces(seed, apart):
    rng = np.random.default_rng(seed)
    vertices, faces = arrays(trimesh.creation.icosphere(1))
    vertices = vertices * rng.uniform(0.5, 2, 3)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    order = rng.permutation(len(faces))

    def by_corner(v, f):
        out = smooth_normals(v, f, crease=pi / 3)
        return np.array([out.normals[out.faces[np.argsort(out.kept)]][k] for k in range(len(f))])

    plain = by_corner(vertices, faces)
    other = by_corner(*((unwelded if apart else lambda v, f: (v, f))(vertices @ rotation.T, faces[order])))
    back = np.empty_like(other)
    back[order] = other
    assert np.abs(back @ rotation - plain).max() < 1e-9
