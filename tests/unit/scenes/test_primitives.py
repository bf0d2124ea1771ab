"""Primitives against their equations: points on the surface, normals its gradient, triangles wound outwards."""

from math import pi

import numpy as np
import pytest

from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.primitives import PRIMITIVES, primitive

VOLUMES = {
    "cube": 8.0,
    "sphere": 4 / 3 * pi,
    "cylinder": 2 * pi,
    "cone": 2 / 3 * pi,
    "torus": 2 * pi**2 * 0.4**2,
    "capsule": pi * 0.25 + 4 / 3 * pi * 0.125,
}


def part(name):
    (only,) = primitive(name).parts
    return only


def corners(vertices, faces):
    return np.asarray(vertices, np.float64)[faces]


@pytest.mark.parametrize("name", PRIMITIVES)
def test_fits_the_frame_and_is_centred(name):
    only = part(name)
    assert (only.vertices.dtype, only.normals.dtype, only.faces.dtype) == (np.float32, np.float32, np.int32)
    assert np.isclose(np.linalg.norm(only.vertices, axis=1).max(), FIT_RADIUS, rtol=1e-6)
    assert np.allclose(only.vertices.min(axis=0), -only.vertices.max(axis=0), atol=1e-6)
    assert np.allclose(np.linalg.norm(only.normals, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("name", PRIMITIVES)
def test_normals_are_on_the_side_the_winding_says(name):
    only = part(name)
    a, b, c = corners(only.vertices, only.faces).transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    lengths = np.linalg.norm(cross, axis=1)
    assert lengths.min() > 0, "no triangle without an area"
    flat = cross / lengths[:, None]
    agreement = np.einsum("ij,ikj->ik", flat, only.normals[only.faces])
    # Smooth normals differ from flat ones by half a segment's angle at most (128 segments; the torus's tube has 64).
    assert agreement.min() > np.cos(2 * pi / 64 * 0.75)


@pytest.mark.parametrize("name", VOLUMES)
def test_closed_solids_have_their_volume(name):
    vertices, _, faces = PRIMITIVES[name]()
    a, b, c = corners(vertices, faces).transpose(1, 0, 2)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    # Flat facets cut off (2π/64)²/6 = 0.16 % at the coarsest, inwards; a hole or a turned cap would cost far more.
    assert volume == pytest.approx(VOLUMES[name], rel=4e-3)


def test_the_sphere_is_round_enough_for_closed_forms():
    only = part("sphere")
    directions = only.vertices / FIT_RADIUS
    assert np.abs(only.normals - directions).max() < 1e-6
    middles = corners(only.vertices, only.faces).mean(axis=1)
    assert np.linalg.norm(middles, axis=1).min() > FIT_RADIUS * (1 - 5e-4)


def test_the_torus_is_on_its_equation():
    vertices, normals, _ = PRIMITIVES["torus"]()
    ring = vertices * [1, 0, 1]
    ring /= np.linalg.norm(ring, axis=1, keepdims=True)
    assert np.allclose(np.linalg.norm(vertices - ring, axis=1), 0.4)
    assert np.allclose((vertices - ring) / 0.4, normals)


def test_the_capsule_is_on_its_equation():
    vertices, normals, _ = PRIMITIVES["capsule"]()
    spine = vertices * [0, 1, 0]
    spine[:, 1] = spine[:, 1].clip(-0.5, 0.5)
    assert np.allclose((vertices - spine) / 0.5, normals)


def test_the_cones_side_leans_outwards_by_its_slope():
    vertices, normals, _ = PRIMITIVES["cone"]()
    side = normals[:, 1] > 0
    assert np.allclose(normals[side][:, 1], 1 / np.sqrt(5))
    along = vertices[side] - [0, 1, 0]
    assert np.abs(np.einsum("ij,ij->i", along, normals[side])).max() < 1e-12


def test_an_unknown_primitive_is_a_key_error():
    with pytest.raises(KeyError):
        primitive("dodecahedron")


def test_primitives_have_different_digests_that_stay():
    digests = {name: primitive(name).sha256 for name in PRIMITIVES}
    assert len(set(digests.values())) == len(PRIMITIVES)
    assert digests == {name: primitive(name).sha256 for name in PRIMITIVES}
