"""Mesh files that are too large, or that declare more than they hold, are refused before they take memory."""

import struct

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.reading import gltf
from scene_attack.scenes.reading.formats import KINDS, read_mesh
from scene_attack.scenes.reading.gltf import GltfFile
from tests.unit.scenes.mesh_files import (
    ASCII_PLY,
    ASCII_STL,
    BOXES,
    MAX_FACES,
    PLY_HEADER,
    assert_refused,
    edited_glb,
    glb,
    split_glb,
)
from tests.unit.scenes.test_gltf import one, texture_of
from tests.unit.scenes.test_image_file import png_of_size
from tests.unit.scenes.test_mesh_textures import textured


@pytest.mark.parametrize("kind", KINDS)
def test_too_many_triangles_are_refused(kind):
    with pytest.raises(InvalidRequest) as refused:
        read_mesh(BOXES[kind], kind, 11)
    assert refused.value.field == "file"
    assert refused.value.detail == (
        "it declares 12 triangles, and at most 11 are taken; simplify it, by Blender's modifier Decimate or by "
        "trimesh's simplify_quadric_decimation, or raise the service's setting SCENE_ATTACK_MAX_FACES"
    )
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
        ("ply", PLY_HEADER.format(format="ascii", vertices=1, faces=99, count="uchar") + "0 0 0\n", "elements"),
        ("ply", PLY_HEADER.format(format="ascii", vertices=-3, faces=1, count="uchar") + "0 0 0\n", "negative"),
        ("ply", PLY_HEADER.format(format="ascii", vertices=3, faces=1, count="complex") + "0 0 0\n", "damaged"),
        ("ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "PLY header"),
        (
            "ply",
            PLY_HEADER.format(format="ascii", vertices=3, faces=1, count="uchar") + "0 0 0\n1 0 0\n0 1 x\n3 0 1 2\n",
            "'x'",
        ),
        ("off", "OFF\n3 1000000000000 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "declares"),
        ("off", "OFF\n1000000000000 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "declares"),
        ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "damaged"),
        ("off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 z\n3 0 1 2\n", "'z'"),
        ("stl", "solid a\nendsolid a\n", "no triangles"),
        ("stl", ASCII_STL.decode().replace("vertex", "vertex x", 1), "incomplete"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "vertex numbers"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 y\nf 1 2 3\n", "'y'"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "vertex numbers"),
        ("obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2 3\n", "no faces"),
        ("obj", "f 1 2 3\n", "no vertices"),
        ("obj", "\n" * 20_000 + "v", "no vertices"),
        ("obj", "\n \t\n" * 5_000 + "f 1 2 3\n", "no vertices"),
        ("obj", "v 0 0 0\n" + "f\n" * 300_001, "at most 300,000"),
        ("obj", "v 0 0 0\n" + "".join(f"usemtl {k}\nf 1 1 1\n" for k in range(2_001)), "2,001 materials"),
        ("stl", "solid a\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendsolid a\n" * 2_001, "2,001 solids"),
        ("ply", ASCII_PLY.decode() + "\n" * 1_001, "1,001 lines more"),
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


@pytest.mark.parametrize(
    ("name", "count"),
    [("accessors", 50_001), ("images", 257), ("materials", 1_001), ("textures", 1_001), ("meshes", 10_001)],
)
def test_the_elements_of_a_glb_are_counted(name, count):
    entry = {"bufferView": 0, "componentType": 5126, "count": 1, "type": "VEC3"}
    assert_refused(
        edited_glb(lambda tree: tree.update({name: [entry] * count})), "glb", f"has {count:,} {name}; at most"
    )


def test_the_parts_of_a_glb_are_counted():
    """Primitives of 12 triangles: 2,001 are 24,012 triangles, which would be taken."""

    def many(tree):
        primitive = tree["meshes"][0]["primitives"][0]
        tree["meshes"][0]["primitives"] = [primitive] * 3
        tree.update(nodes=[{"mesh": 0}] * 667, scenes=[{"nodes": list(range(667))}], scene=0)

    assert_refused(edited_glb(many), "glb", "2,001 primitives; at most 2,000")


def test_a_glb_whose_parts_repeat_a_large_texture_is_refused(monkeypatch):
    monkeypatch.setattr(gltf, "MAX_TEXELS", 2 * 6 * 4 * 4 - 1)
    data = textured(6, 4)
    read_mesh(data, "glb", 12)
    tree, body = split_glb(data)
    tree["meshes"][0]["primitives"] *= 2
    assert_refused(glb(tree, body), "glb", "textures of its parts take 192 bytes")


def test_an_attribute_of_another_length_than_the_vertices_is_refused_before_it_is_read():
    def normals(tree):
        tree["accessors"].append({"bufferView": 0, "componentType": 5120, "count": 10**8, "type": "VEC3"})
        tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = len(tree["accessors"]) - 1

    assert_refused(edited_glb(normals), "glb", "100,000,000 of NORMAL")


def test_a_buffer_that_declares_more_than_the_file_holds_is_refused():
    assert_refused(edited_glb(lambda tree: tree["buffers"][0].update(byteLength=10**6)), "glb", "buffers[0].byteLength")


def test_images_of_the_same_bytes_are_one():
    writer = one({}, texture_of(png_of_size(1, 1)))
    image = writer.tree["images"][0]
    writer.tree["images"] = [image, dict(image)]
    file = GltfFile(writer.glb())
    assert file.image(0) is file.image(1)


def test_what_an_error_quotes_of_a_file_is_cut():
    data = edited_glb(lambda tree: tree.update(extensionsRequired=["long"] * 10_000))
    with pytest.raises(InvalidRequest) as error:
        read_mesh(data, "glb", MAX_FACES)
    assert len(error.value.detail) < 1_000


@pytest.mark.parametrize("kind", ["obj", "off"])
def test_text_that_is_not_utf_8_is_read(kind):
    """Exporters write names of materials in the encoding of their machine."""
    first, _, rest = BOXES[kind].partition(b"\n")
    parts = read_mesh(first + b"\n# b\xfcro\n" + rest, kind, MAX_FACES)
    assert sum(len(part.faces) for part in parts) == 12
