"""Files that are damaged in a way that only a parser notices: what is said of them is about the file."""

from io import BytesIO

import numpy as np
import pytest
import trimesh
from PIL import Image

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.reading.companion_files import CompanionFiles
from scene_attack.scenes.reading.formats import read_mesh
from scene_attack.scenes.reading.process import exported

BOX = trimesh.creation.box()
INTERNALS = ("Error", "Stream", "codec", "sys.", "Expecting", "int()", "float:", "method", "matmul", "seek")
GLTF = exported(BOX, "gltf")
DAMAGED = {
    "half a COLLADA file": ("dae", exported(BOX, "dae")[:-300], "it is damaged, or cut off"),
    "a face of a corner that is not there": ("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
    "half a glTF file": (
        "gltf",
        GLTF[: len(GLTF) // 2],
        "its JSON cannot be read: it is not JSON: a text has",
    ),
    "a glTF file in another encoding": ("gltf", b'{"asset": "\xff"}', "its JSON cannot be read: it is not UTF-8 text"),
    "a number of 5,000 digits": ("gltf", b'{"asset": ' + b"9" * 5000 + b"}", "a number of more than 4,300 digits"),
    "a nested glTF file": ("gltf", b'{"asset": ' + b"[" * 3000, "nested deeper than 64"),
    "a ply file in another encoding": ("ply", b"ply\nformat ascii 1.0\ncomment \xff\xfe\n", ""),
    "an off file with a long number": ("off", b"OFF\n" + b"9" * 5000 + b" 1 0\n", "it is damaged, or cut off"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_mesh_is_described_in_words(name: str) -> None:
    kind, data, said = DAMAGED[name]
    with pytest.raises(InvalidRequest) as raised:
        read_mesh(data, kind, 1000)
    assert raised.value.field == "file"
    assert said in raised.value.detail
    assert not [one for one in INTERNALS if one in raised.value.detail], raised.value.detail


def test_a_damaged_texture_is_described_in_words() -> None:
    buffer = BytesIO()
    noise = np.random.default_rng(3).integers(0, 256, (64, 64, 3), np.uint8)
    Image.fromarray(noise).save(buffer, "JPEG")
    files = {"a.mtl": b"newmtl m\nmap_Kd t.jpg\n", "t.jpg": buffer.getvalue()[:1500]}
    obj = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
    with pytest.raises(InvalidRequest) as raised:
        read_mesh(obj, "obj", 10, CompanionFiles(files, "obj", obj))
    assert raised.value.detail == "it cannot be shown: a texture or its coordinates are damaged, or cut off"
