"""Mesh files of every kind, as bytes, and what reading them gives or refuses."""

import base64
import io
import json
import struct
import zipfile

import numpy as np
import pytest
import trimesh

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.reading.formats import KINDS, read_mesh
from scene_attack.scenes.reading.process import exported

MAX_FACES = 300_000
RIGHT_TRIANGLE = ["0", "0", "0", "1", "0", "0", "0", "1", "0"]
PLY_HEADER = (
    "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {faces}\nproperty list {count} int vertex_indices\nend_header\n"
)

DAE_TRIANGLE = (
    '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
    '<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="9">{points}</float_array>'
    '<technique_common><accessor source="#a" count="3" stride="3"><param name="X" type="float"/>'
    '<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>'
    '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="1">'
    '<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry></library_geometries>'
    '<library_visual_scenes><visual_scene id="w"><node id="n"><instance_geometry url="#g"/></node></visual_scene>'
    '</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>'
)
MODEL_TRIANGLE = (
    '<?xml version="1.0"?><model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
    '<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles><triangle v1="0" v2="1" v3="2"/>'
    '</triangles></mesh></object></resources><build><item objectid="1"/></build></model>'
)


def box(kind):
    """A box of 1 x 2 x 3 as a file of `kind`."""
    return exported(trimesh.creation.box((1, 2, 3)), kind)


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
    if kind == "dae":
        return DAE_TRIANGLE.format(points=" ".join(points)).encode()
    if kind == "3mf":
        vertices = "".join(f'<vertex x="{points[k]}" y="{points[k + 1]}" z="{points[k + 2]}"/>' for k in (0, 3, 6))
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as archive:
            archive.writestr("3D/3dmodel.model", MODEL_TRIANGLE.format(vertices=vertices))
        return buffer.getvalue()
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
    body = struct.pack("<9f", *numbers)
    if kind == "gltf":
        tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
        return json.dumps(tree).encode()
    return glb(tree, body)


def assert_refused(data, kind, word, field="file", max_faces=MAX_FACES):
    with pytest.raises(InvalidRequest) as error:
        read_mesh(data, kind, max_faces)
    assert error.value.field == field
    assert word in error.value.detail, error.value.detail


def extent(parts):
    """Lengths [3] of the edges of the bounding box."""
    points = np.concatenate([part.vertices for part in parts])
    return points.max(axis=0) - points.min(axis=0)


def same(one: object, other: object) -> bool:
    """Whether two objects of data classes, mappings and arrays are equal to the bit."""
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, dict):
        return isinstance(other, dict) and list(one) == list(other) and all(same(one[k], other[k]) for k in one)
    if hasattr(one, "__dict__"):
        return type(one) is type(other) and same(vars(one), vars(other))
    return one == other
