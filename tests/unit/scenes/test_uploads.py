"""Uploaded meshes: every kind is read, everything else is refused with a reason, and nothing is fetched or run."""

import base64
import contextlib
import json
import struct
from io import BytesIO

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from PIL import Image

from services.errors import InvalidRequest, JobFailure
from services.scenes import surfaces, uploads
from services.scenes.library import Library
from services.scenes.mesh import FIT_RADIUS
from services.scenes.reading import KINDS, read_mesh
from services.settings import Settings

MANY = 300_000


def box(kind, size=(1, 2, 3), **options):
    data = trimesh.creation.box(size).export(file_type=kind, **options)
    return data.encode() if isinstance(data, str) else data


ASCII_STL = trimesh.creation.box((1, 2, 3)).export(file_type="stl_ascii").encode()
ASCII_PLY = trimesh.creation.box((1, 2, 3)).export(file_type="ply", encoding="ascii")
GOOD = {kind: box(kind) for kind in KINDS}


def glb(tree, body=b""):
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if body:
        chunks += struct.pack("<II", len(body), 0x004E4942) + body
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def tree_of(data):
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[20 + length + 8 :]


def edited(edit):
    tree, body = tree_of(GOOD["glb"])
    edit(tree)
    return glb(tree, body)


def refused(data, kind, word, field="file", max_faces=MANY):
    with pytest.raises(InvalidRequest) as error:
        read_mesh(data, kind, max_faces)
    assert error.value.field == field
    assert word in error.value.detail, error.value.detail


def extent(parts):
    points = np.concatenate([part.vertices for part in parts])
    return points.max(axis=0) - points.min(axis=0)


@pytest.mark.parametrize(
    ("kind", "data"), [*GOOD.items(), ("stl", ASCII_STL), ("ply", ASCII_PLY)], ids=[*GOOD, "stl text", "ply text"]
)
def test_every_kind_is_read_and_fitted(kind, data):
    parts = read_mesh(data, kind, MANY)
    size = extent(parts)
    assert np.allclose(size / size[0], [1, 2, 3], atol=1e-5)
    assert np.linalg.norm(size) / 2 == pytest.approx(FIT_RADIUS, rel=1e-5)
    assert sum(len(part.faces) for part in parts) == 12
    for part in parts:
        assert np.allclose(np.sort(np.abs(part.normals), axis=1), [0, 0, 1], atol=1e-5)
        assert ((part.vertices * part.normals).sum(axis=1) > 0).all(), "normals point outwards"


@pytest.mark.parametrize("kind", ["exe", "OBJ", "", "gltf", "../obj", "stl_ascii", "zip", "3mf"])
def test_other_kinds_are_refused(kind):
    refused(GOOD["obj"], kind, "obj, ply, stl, glb, off", field="kind")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("data", [b"", b" \n\t "])
def test_empty_files_are_refused(kind, data):
    refused(data, kind, "empty")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("other", [*KINDS, "png", "zip", "noise"])
def test_files_that_are_something_else_are_refused(kind, other):
    if kind == other:
        return
    image = BytesIO()
    Image.new("RGB", (4, 4)).save(image, "PNG")
    noise = np.random.default_rng(0).integers(0, 256, 500, dtype=np.uint8).tobytes()
    data = {**GOOD, "png": image.getvalue(), "zip": b"PK\x03\x04" + bytes(100), "noise": noise}[other]
    refused(data, kind, f"not a readable {kind} mesh")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
def test_truncated_files_are_refused(kind, share):
    data = GOOD[kind]
    if kind == "obj":
        # An OBJ file has no end mark; what is cut off must at least not leave faces without their vertices.
        data = b"\n".join(line for line in reversed(data.splitlines()) if line[:1] in b"vf")
    refused(data[: int(len(data) * share)], kind, "")


@pytest.mark.parametrize("kind", KINDS)
def test_too_many_triangles_are_refused(kind):
    refused(GOOD[kind], kind, "at most 11", max_faces=11)
    read_mesh(GOOD[kind], kind, 12)


@pytest.mark.parametrize("kind", ["obj", "ply", "off"])
def test_too_many_vertices_are_refused(kind):
    vertices, head = b"0 0 0\n" * 31, PLY.format(format="ascii", vertices=31, faces=1, count="uchar").encode()
    data = {
        "obj": b"v 0 0 0\n" * 31 + b"f 1 2 3\n",
        "off": b"OFF\n31 1 0\n" + vertices + b"3 0 1 2\n",
        "ply": head + vertices + b"3 0 1 2\n",
    }[kind]
    refused(data, kind, "at most 30", max_faces=10)


def test_polygons_count_as_the_triangles_they_become():
    quads = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n" + b"f 1 2 3 4\n"
    refused(quads, "obj", "at most 1", max_faces=1)
    pentagons = b"OFF\n5 1 0\n0 0 0\n1 0 0\n2 1 0\n1 2 0\n0 1 0\n5 0 1 2 3 4\n"
    refused(pentagons, "off", "at most 2", max_faces=2)
    assert sum(len(part.faces) for part in read_mesh(pentagons, "off", 3)) == 3


def triangle(kind, points):
    """A triangle of the kind with these nine numbers, written as they are."""
    a, b, c = (" ".join(points[k : k + 3]) for k in (0, 3, 6))
    numbers = [float(p) for p in points]
    if kind == "obj":
        return f"v {a}\nv {b}\nv {c}\nf 1 2 3\n".encode()
    if kind == "off":
        return f"OFF\n3 1 0\n{a}\n{b}\n{c}\n3 0 1 2\n".encode()
    if kind == "stl":
        return b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", 0, 0, 1, *numbers, 0)
    if kind == "ply":
        head = (
            "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
            "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
        return head.encode() + struct.pack("<9f", *numbers) + struct.pack("<B3i", 3, 0, 1, 2)
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "scene": 0,
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    }
    return glb(tree, struct.pack("<9f", *numbers))


RIGHT = ["0", "0", "0", "1", "0", "0", "0", "1", "0"]


@pytest.mark.parametrize("kind", KINDS)
def test_one_triangle_is_enough(kind):
    (part,) = read_mesh(triangle(kind, RIGHT), kind, MANY)
    assert np.allclose(part.normals, [0, 0, 1])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_vertices_that_are_not_finite_are_refused(kind, value):
    refused(triangle(kind, [*RIGHT[:4], value, *RIGHT[5:]]), kind, "not finite")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "points", [["1"] * 9, ["0", "0", "0", "1", "1", "1", "2", "2", "2"], ["0", "0", "0", "1", "0", "0", "0", "0", "0"]]
)
def test_meshes_without_area_are_refused(kind, points):
    refused(triangle(kind, points), kind, "area")


@pytest.mark.parametrize("kind", ["obj", "off"])
def test_huge_coordinates_are_refused(kind):
    refused(triangle(kind, [*RIGHT[:3], "1e200", *RIGHT[4:]]), kind, "coordinates beyond")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_do_not_matter(kind, scale):
    parts = read_mesh(triangle(kind, [str(float(p) * scale) for p in RIGHT]), kind, MANY)
    assert np.allclose(extent(parts), extent(read_mesh(triangle(kind, RIGHT), kind, MANY)), rtol=1e-5)


PLY = "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
PLY += "element face {faces}\nproperty list {count} int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("kind", "data", "word"),
    [
        ("ply", PLY.format(format="ascii", vertices=10**12, faces=1, count="uchar") + "0 0 0\n", "declares"),
        ("ply", PLY.format(format="binary_little_endian", vertices=10**12, faces=1, count="uchar"), "declares"),
        ("ply", PLY.format(format="ascii", vertices=3, faces=10**12, count="uchar") + "0 0 0\n", "declares"),
        ("ply", PLY.format(format="ascii", vertices=-3, faces=1, count="uchar") + "0 0 0\n", "negative"),
        ("ply", PLY.format(format="ascii", vertices=3, faces=1, count="complex") + "0 0 0\n", "complex"),
        ("ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "PLY header"),
        (
            "ply",
            PLY.format(format="ascii", vertices=3, faces=1, count="uchar") + "0 0 0\n1 0 0\n0 1 x\n3 0 1 2\n",
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
def test_false_claims_are_refused(kind, data, word):
    refused(data.encode(), kind, word)


def test_a_binary_stl_must_be_as_long_as_it_says():
    lying = b"\0" * 80 + struct.pack("<I", 2**32 - 1) + b"\0" * 50
    refused(lying, "stl", "triangle count")


def test_a_glb_that_declares_more_than_it_holds_is_refused():
    def position(tree):
        return tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]

    refused(edited(lambda tree: position(tree).update(count=10**9)), "glb", "at most")
    refused(edited(lambda tree: position(tree).pop("bufferView")), "glb", "without data")
    refused(edited(lambda tree: tree["bufferViews"].append({"buffer": 0, "byteLength": 10**9})), "glb", "more than")
    refused(
        edited(lambda tree: tree["meshes"][0].update(primitives=tree["meshes"][0]["primitives"] * 10**5)), "glb", "at"
    )
    refused(GOOD["glb"][:-4], "glb", "lengths")
    refused(GOOD["glb"][:4] + struct.pack("<I", 1) + GOOD["glb"][8:], "glb", "glTF 2")


def test_a_glb_whose_nodes_multiply_is_refused():
    def doubling(tree):
        tree["nodes"] = [{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}]
        tree["scenes"] = [{"nodes": [0]}]

    refused(edited(doubling), "glb", "not a tree")
    many = edited(lambda tree: tree.update(nodes=[{"mesh": 0}] * 5000, scenes=[{"nodes": list(range(5000))}], scene=0))
    refused(many, "glb", "60,000 triangles", max_faces=50_000)


@pytest.mark.parametrize("address", ["http://127.0.0.1:9/a.bin", "file:///etc/passwd", "/etc/passwd", "../a.bin"])
def test_nothing_a_mesh_names_is_read(address, monkeypatch):
    opened = []
    monkeypatch.setattr("builtins.open", lambda *a, **_: opened.append(a) or (_ for _ in ()).throw(OSError("closed")))
    monkeypatch.setattr(
        "socket.socket.connect", lambda *a: opened.append(a) or (_ for _ in ()).throw(OSError("closed"))
    )
    obj = f"mtllib {address}\nusemtl a\n".encode() + triangle("obj", RIGHT)
    assert read_mesh(obj, "obj", MANY)[0].texture is None
    ply = ASCII_PLY.replace(b"element vertex", f"comment TextureFile {address}\nelement vertex".encode(), 1)
    assert read_mesh(ply, "ply", MANY)[0].texture is None
    tree, body = tree_of(triangle("glb", RIGHT))
    tree["buffers"].insert(0, {"uri": address, "byteLength": 36})
    tree["bufferViews"][0]["buffer"] = 0
    refused(glb(tree, body), "glb", "not a readable")
    assert opened == []


def textured(width, height, alpha_mode=None):
    out = BytesIO()
    Image.new("RGBA", (width, height), (10, 20, 30, 128)).save(out, "PNG")
    mesh = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.open(out), baseColorFactor=(128, 255, 255, 128), alphaMode=alpha_mode
    )
    mesh.visual = trimesh.visual.TextureVisuals(uv=mesh.vertices[:, :2] + 0.5, material=material)
    return mesh.export(file_type="glb")


def test_a_glb_keeps_its_texture_and_linear_colour():
    (part,) = read_mesh(textured(6, 4), "glb", MANY)
    assert part.metallic_roughness.maps["base_color"].texels.shape == (4, 6, 4)
    assert (part.metallic_roughness.maps["base_color"].texels == (10, 20, 30, 128)).all()
    assert part.metallic_roughness.alpha_mode == "OPAQUE", "without an alpha mode glTF is opaque"
    assert np.allclose(part.color, [128 / 255, 1, 1, 1], atol=1e-3), "glTF factors are linear"
    (blended,) = read_mesh(textured(6, 4, "BLEND"), "glb", MANY)
    assert blended.metallic_roughness.alpha_mode == "BLEND"
    assert blended.color[3] == pytest.approx(128 / 255, abs=1e-3)


def test_a_image_bomb_is_refused(monkeypatch):
    monkeypatch.setattr(surfaces, "MAX_TEXTURE_SOURCE", 6 * 4 - 1)
    refused(textured(6, 4), "glb", "pixels")


def test_face_and_vertex_colours_are_kept():
    mesh = trimesh.creation.box()
    colors = np.zeros((12, 4), np.uint8) + 255
    colors[:, 0] = np.arange(12) * 20
    mesh.visual.face_colors = colors
    (part,) = read_mesh(mesh.export(file_type="ply"), "ply", MANY)
    # One texel a colour, met in its middle by all corners of a face.
    height, width = part.texture.shape[:2]
    column, row = part.uv[:, 0] * width - 0.5, (1 - part.uv[:, 1]) * height - 0.5
    assert np.allclose(column, np.rint(column), atol=1e-4)
    seen = part.texture[np.rint(row).astype(int), np.rint(column).astype(int)][part.faces]
    assert (seen == seen[:, :1]).all()
    assert sorted(seen[:, 0, 0]) == sorted(colors[:, 0])


def test_the_mesh_limit_is_the_settings(tmp_path, monkeypatch):
    library = Library(tmp_path / "cache", tmp_path / "data")
    monkeypatch.setattr(uploads, "settings", lambda: Settings(max_upload_bytes=len(GOOD["obj"]) - 1))
    with pytest.raises(InvalidRequest, match=r"file: it has .* bytes; at most"):
        library.add_mesh(GOOD["obj"], "obj")
    monkeypatch.setattr(uploads, "settings", lambda: Settings(max_faces=11))
    with pytest.raises(InvalidRequest, match="at most 11"):
        library.add_mesh(GOOD["obj"], "obj")
    assert not (tmp_path / "data" / "assets").exists(), "nothing is kept of what was refused"


def test_uploads_are_kept_by_content_once(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    first, second = library.add_mesh(GOOD["stl"], "stl"), library.add_mesh(GOOD["stl"], "stl")
    assert first == second
    assets = tmp_path / "data" / "assets"
    digest = first.name.removeprefix("sha256:")
    assert sorted(path.name for path in assets.iterdir()) == [digest, f"{digest}.json"]
    assert (assets / digest).read_bytes() == GOOD["stl"]
    assert json.loads((assets / f"{digest}.json").read_bytes()) == {
        "sha256": digest,
        "kind": "stl",
        "size": len(GOOD["stl"]),
        "triangles": 12,
    }
    assert library.mesh(first.name).sha256 == digest


def test_what_was_processed_may_be_deleted(tmp_path):
    entry = Library(tmp_path / "cache", tmp_path / "data").add_mesh(GOOD["ply"], "ply")
    before = Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)
    for path in (tmp_path / "cache" / "meshes").glob("*.npz"):
        path.unlink()
    after = Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)
    assert np.array_equal(before.parts[0].vertices, after.parts[0].vertices)


@pytest.mark.parametrize("damage", ["gone", "changed"])
def test_an_upload_that_was_lost_is_a_missing_asset(tmp_path, damage):
    entry = Library(tmp_path / "cache", tmp_path / "data").add_mesh(GOOD["ply"], "ply")
    for path in (tmp_path / "cache" / "meshes").glob("*.npz"):
        path.unlink()
    file = tmp_path / "data" / "assets" / entry.name.removeprefix("sha256:")
    file.unlink() if damage == "gone" else file.write_bytes(GOOD["obj"])
    with pytest.raises(JobFailure, match=f"asset-missing.*{damage}"):
        Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)


@hypothesis_settings(max_examples=150, deadline=None)
@given(st.sampled_from(KINDS), st.data())
def test_a_damaged_file_is_read_or_refused_and_nothing_else(kind, data):
    damaged = bytearray(GOOD[kind])
    for _ in range(data.draw(st.integers(1, 5))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    parts = ()
    with contextlib.suppress(InvalidRequest):
        parts = read_mesh(bytes(damaged), kind, MANY)
    assert all(np.isfinite(part.vertices).all() and np.isfinite(part.normals).all() for part in parts)


def test_base64_buffers_inside_a_glb_are_read():
    tree, body = tree_of(triangle("glb", RIGHT))
    tree["buffers"] = [
        {"uri": "data:application/octet-stream;base64," + base64.b64encode(body).decode(), "byteLength": 36}
    ]
    assert len(read_mesh(glb(tree), "glb", MANY)) == 1
