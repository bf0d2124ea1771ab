"""Mesh files of every kind are read, or refused with a reason if their bytes or coordinates make no mesh."""

import base64
import contextlib
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from PIL import Image

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.reading.formats import KINDS, read_mesh
from tests.unit.scenes.mesh_files import (
    ASCII_PLY,
    ASCII_STL,
    BOXES,
    MAX_FACES,
    RIGHT_TRIANGLE,
    assert_refused,
    extent,
    glb,
    split_glb,
    triangle,
)


@pytest.mark.parametrize(
    ("kind", "data"), [*BOXES.items(), ("stl", ASCII_STL), ("ply", ASCII_PLY)], ids=[*BOXES, "stl text", "ply text"]
)
def test_every_kind_is_read_and_fitted(kind, data):
    parts = read_mesh(data, kind, MAX_FACES)
    size = extent(parts)
    # A 3mf has +z upwards.
    assert np.allclose(size / size[0], [1, 3, 2] if kind == "3mf" else [1, 2, 3], atol=1e-5)
    assert np.linalg.norm(size) / 2 == pytest.approx(FIT_RADIUS, rel=1e-5)
    assert sum(len(part.faces) for part in parts) == 12
    for part in parts:
        assert np.allclose(np.sort(np.abs(part.normals), axis=1), [0, 0, 1], atol=1e-5)
        assert ((part.vertices * part.normals).sum(axis=1) > 0).all(), "normals point outwards"


@pytest.mark.parametrize("kind", ["exe", "OBJ", "", "blend", "../obj", "stl_ascii", "zip", "usd"])
def test_other_kinds_are_refused(kind):
    assert_refused(BOXES["obj"], kind, "obj, ply, stl, glb, off", field="kind")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("data", [b"", b" \n\t "])
def test_empty_files_are_refused(kind, data):
    assert_refused(data, kind, "empty")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("other", [*KINDS, "png", "zip", "noise"])
def test_files_of_another_kind_than_named_are_refused(kind, other):
    if kind == other:
        return
    image = BytesIO()
    Image.new("RGB", (4, 4)).save(image, "PNG")
    noise = np.random.default_rng(0).integers(0, 256, 500, dtype=np.uint8).tobytes()
    data = {**BOXES, "png": image.getvalue(), "zip": b"PK\x03\x04" + bytes(100), "noise": noise}[other]
    assert_refused(data, kind, f"not a readable {kind} mesh")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
def test_truncated_files_are_refused(kind, share):
    data = BOXES[kind]
    if kind == "obj":
        # An OBJ file has no end mark; what is cut off must at least not leave faces without their vertices.
        data = b"\n".join(line for line in reversed(data.splitlines()) if line[:1] in b"vf")
    assert_refused(data[: int(len(data) * share)], kind, "")


@hypothesis_settings(max_examples=150, deadline=None)
@given(st.sampled_from(KINDS), st.data())
def test_a_damaged_file_is_read_or_refused_with_a_reason(kind, data):
    damaged = bytearray(BOXES[kind])
    for _ in range(data.draw(st.integers(1, 5))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    parts = ()
    with contextlib.suppress(InvalidRequest):
        parts = read_mesh(bytes(damaged), kind, MAX_FACES)
    assert all(np.isfinite(part.vertices).all() and np.isfinite(part.normals).all() for part in parts)


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_one_triangle_is_read(kind):
    (part,) = read_mesh(triangle(kind, RIGHT_TRIANGLE), kind, MAX_FACES)
    assert np.allclose(part.normals, [0, 1, 0] if kind == "3mf" else [0, 0, 1])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_vertices_that_are_not_finite_are_refused(kind, value):
    assert_refused(triangle(kind, [*RIGHT_TRIANGLE[:4], value, *RIGHT_TRIANGLE[5:]]), kind, "not finite")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "points", [["1"] * 9, ["0", "0", "0", "1", "1", "1", "2", "2", "2"], ["0", "0", "0", "1", "0", "0", "0", "0", "0"]]
)
def test_meshes_without_area_are_refused(kind, points):
    assert_refused(triangle(kind, points), kind, "area")


@pytest.mark.parametrize("kind", ["obj", "off"])
def test_huge_coordinates_are_refused(kind):
    assert_refused(triangle(kind, [*RIGHT_TRIANGLE[:3], "1e200", *RIGHT_TRIANGLE[4:]]), kind, "coordinates beyond")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_meshes_are_fitted_whatever_their_unit_of_length(kind, scale):
    parts = read_mesh(triangle(kind, [str(float(p) * scale) for p in RIGHT_TRIANGLE]), kind, MAX_FACES)
    assert np.allclose(extent(parts), extent(read_mesh(triangle(kind, RIGHT_TRIANGLE), kind, MAX_FACES)), rtol=1e-5)


def test_base64_buffers_inside_a_glb_are_read():
    tree, body = split_glb(triangle("glb", RIGHT_TRIANGLE))
    tree["buffers"] = [
        {"uri": "data:application/octet-stream;base64," + base64.b64encode(body).decode(), "byteLength": 36}
    ]
    assert len(read_mesh(glb(tree), "glb", MAX_FACES)) == 1
