"""Files that are damaged in a way that only a parser notices: what is said of them is about the file."""

import base64
import zipfile
from io import BytesIO

import numpy as np
import pytest
import trimesh
from PIL import Image

from services.errors import InvalidRequest
from services.scenes.bundle import unpack_archive
from services.scenes.environment import read_map
from services.scenes.reading.companion_files import CompanionFiles
from services.scenes.reading.formats import read_mesh
from services.scenes.reading.process import SMALL_EXR, exported

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


HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=much\n\n-Y 1 +X 1\n" + bytes(4)


@pytest.mark.parametrize(
    ("kind", "data", "said"),
    [
        ("exr", b"junk", "it is damaged, or cut off"),
        ("exr", base64.b64decode(SMALL_EXR)[:200], "it is damaged, or cut off"),
        ("hdr", HDR, "its EXPOSURE is 'much', which is no number"),
    ],
)
def test_a_damaged_map_is_described_in_words(kind: str, data: bytes, said: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        read_map(data, kind)
    assert raised.value.detail == f"it is not a readable {kind} map: {said}"


def test_a_damaged_texture_is_described_in_words() -> None:
    buffer = BytesIO()
    noise = np.random.default_rng(3).integers(0, 256, (64, 64, 3), np.uint8)
    Image.fromarray(noise).save(buffer, "JPEG")
    files = {"a.mtl": b"newmtl m\nmap_Kd t.jpg\n", "t.jpg": buffer.getvalue()[:1500]}
    obj = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
    with pytest.raises(InvalidRequest) as raised:
        read_mesh(obj, "obj", 10, CompanionFiles(files, "obj", obj))
    assert raised.value.detail == "it cannot be shown: a texture or its coordinates are damaged, or cut off"


def test_a_damaged_zip_file_is_described_in_words() -> None:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.obj", " ".join(map(str, range(1000))))
    data = bytearray(buffer.getvalue())
    data[40:400] = bytes(range(180)) * 2  # the compressed bytes; their check is never reached
    with pytest.raises(InvalidRequest) as raised:
        unpack_archive(bytes(data), 10_000)
    assert raised.value.detail == "the zip file is damaged, or cut off"
