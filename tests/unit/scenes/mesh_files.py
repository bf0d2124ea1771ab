"""Mesh files of every kind, as bytes, and what reading them gives or refuses."""

import json
import struct

import numpy as np
import pytest
import trimesh

from services.errors import InvalidRequest
from services.scenes.reading import KINDS, read_mesh

MAX_FACES = 300_000
RIGHT_TRIANGLE = ["0", "0", "0", "1", "0", "0", "0", "1", "0"]
PLY_HEADER = (
    "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {faces}\nproperty list {count} int vertex_indices\nend_header\n"
)


def box(kind):
    """A box of 1 x 2 x 3 as a file of `kind`."""
    data = trimesh.creation.box((1, 2, 3)).export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


ASCII_STL = trimesh.creation.box((1, 2, 3)).export(file_type="stl_ascii").encode()
ASCII_PLY = trimesh.creation.box((1, 2, 3)).export(file_type="ply", encoding="ascii")
BOXES = {kind: box(kind) for kind in KINDS}


def glb(tree, body=b""):
    """A glTF file of a JSON tree and a binary chunk."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if body:
        chunks += struct.pack("<II", len(body), 0x004E4942) + body
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def split_glb(data):
    """The JSON tree and the binary chunk of a glTF file."""
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[20 + length + 8 :]


def edited_glb(edit):
    """The box as a glTF file, after `edit` has changed its JSON tree."""
    tree, body = split_glb(BOXES["glb"])
    edit(tree)
    return glb(tree, body)


def triangle(kind, points):
    """A file of `kind` with one triangle, whose nine coordinates are written as given."""
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


def assert_refused(data, kind, word, field="file", max_faces=MAX_FACES):
    with pytest.raises(InvalidRequest) as error:
        read_mesh(data, kind, max_faces)
    assert error.value.field == field
    assert word in error.value.detail, error.value.detail


def extent(parts):
    """Lengths [3] of the edges of the bounding box."""
    points = np.concatenate([part.vertices for part in parts])
    return points.max(axis=0) - points.min(axis=0)
