"""Mesh files that are too large, or that declare more than they hold, are refused before they take memory."""

import struct

import pytest

from services.scenes.reading import KINDS, read_mesh
from tests.unit.scenes.mesh_files import ASCII_STL, BOXES, PLY_HEADER, assert_refused, edited_glb


@pytest.mark.parametrize("kind", KINDS)
def test_too_many_triangles_are_refused(kind):
    assert_refused(BOXES[kind], kind, "at most 11", max_faces=11)
    read_mesh(BOXES[kind], kind, 12)


@pytest.mark.parametrize("kind", ["obj", "ply", "off"])
def test_too_many_vertices_are_refused(kind):
    vertices, head = b"0 0 0\n" * 31, PLY_HEADER.format(format="ascii", vertices=31, faces=1, count="uchar").encode()
    data = {
        "obj": b"v 0 0 0\n" * 31 + b"f 1 2 3\n",
        "off": b"OFF\n31 1 0\n" + vertices + b"3 0 1 2\n",
        "ply": head + vertices + b"3 0 1 2\n",
    }[kind]
    assert_refused(data, kind, "at most 30", max_faces=10)


def test_polygons_count_as_the_triangles_they_become():
    quads = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n" + b"f 1 2 3 4\n"
    assert_refused(quads, "obj", "at most 1", max_faces=1)
    pentagons = b"OFF\n5 1 0\n0 0 0\n1 0 0\n2 1 0\n1 2 0\n0 1 0\n5 0 1 2 3 4\n"
    assert_refused(pentagons, "off", "at most 2", max_faces=2)
    assert sum(len(part.faces) for part in read_mesh(pentagons, "off", 3)) == 3


@pytest.mark.parametrize(
    ("kind", "data", "word"),
    [
        ("ply", PLY_HEADER.format(format="ascii", vertices=10**12, faces=1, count="uchar") + "0 0 0\n", "declares"),
        ("ply", PLY_HEADER.format(format="binary_little_endian", vertices=10**12, faces=1, count="uchar"), "declares"),
        ("ply", PLY_HEADER.format(format="ascii", vertices=3, faces=10**12, count="uchar") + "0 0 0\n", "declares"),
        ("ply", PLY_HEADER.format(format="ascii", vertices=-3, faces=1, count="uchar") + "0 0 0\n", "negative"),
        ("ply", PLY_HEADER.format(format="ascii", vertices=3, faces=1, count="complex") + "0 0 0\n", "complex"),
        ("ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "PLY header"),
        (
            "ply",
            PLY_HEADER.format(format="ascii", vertices=3, faces=1, count="uchar") + "0 0 0\n1 0 0\n0 1 x\n3 0 1 2\n",
            "'x'",
        ),
        ("off", "OFF\n3 1000000000000 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "declares"),
        ("off", "OFF\n1000000000000 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "declares"),
        ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "range"),
        ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 z\n3 0 1 2\n", "'z'"),
        ("stl", "solid a\nendsolid a\n", "no triangles"),
        ("stl", ASCII_STL.decode().replace("vertex", "vertex x", 1), "incomplete"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "vertex numbers"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 y\nf 1 2 3\n", "'y'"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "vertex numbers"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2 3\n", "no faces"),
        ("obj", "f 1 2 3\n", "no vertices"),
    ],
)
def test_files_that_contradict_themselves_are_refused(kind, data, word):
    assert_refused(data.encode(), kind, word)


def test_a_binary_stl_whose_length_is_not_the_declared_one_is_refused():
    short = b"\0" * 80 + struct.pack("<I", 2**32 - 1) + b"\0" * 50
    assert_refused(short, "stl", "triangle count")


def test_a_glb_that_declares_more_than_it_holds_is_refused():
    def position(tree):
        return tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]

    assert_refused(edited_glb(lambda tree: position(tree).update(count=10**9)), "glb", "at most")
    assert_refused(edited_glb(lambda tree: position(tree).pop("bufferView")), "glb", "without data")
    assert_refused(
        edited_glb(lambda tree: tree["bufferViews"].append({"buffer": 0, "byteLength": 10**9})), "glb", "more than"
    )
    assert_refused(
        edited_glb(lambda tree: tree["meshes"][0].update(primitives=tree["meshes"][0]["primitives"] * 10**5)),
        "glb",
        "at",
    )
    assert_refused(BOXES["glb"][:-4], "glb", "complete")
    assert_refused(BOXES["glb"][:4] + struct.pack("<I", 1) + BOXES["glb"][8:], "glb", "glTF 2")


def test_a_glb_whose_nodes_multiply_is_refused():
    def doubling(tree):
        tree["nodes"] = [{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}]
        tree["scenes"] = [{"nodes": [0]}]

    assert_refused(edited_glb(doubling), "glb", "not a tree")
    many = edited_glb(
        lambda tree: tree.update(nodes=[{"mesh": 0}] * 5000, scenes=[{"nodes": list(range(5000))}], scene=0)
    )
    assert_refused(many, "glb", "60,000 triangles", max_faces=50_000)
