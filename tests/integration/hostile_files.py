"""Files that are damaged, that lie about themselves, or that would take long, much memory or a program to read."""

import base64
import gzip
import io
import random
import struct
import zipfile
from collections.abc import Callable, Iterator
from itertools import cycle

from scene_attack.scenes.reading.formats import KINDS
from tests.integration.hostile_glb import GLB, MILLION, texture_at
from tests.unit.scenes.mesh_files import ASCII_PLY, ASCII_STL, BOXES, PLY_HEADER, edited_glb
from tests.unit.scenes.test_image_file import POSTSCRIPT, png_of_size, stored, vp8x

Case = tuple[str, bytes, str | None]
"""A kind, a file, and the field that is refused; None for an odd file that is a mesh."""
NOISE = random.Random(14).randbytes(5_000)
CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def archive() -> bytes:
    """100 MB of zeros as a zip file of 0.1 MB."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("mesh.obj", bytes(100 * MILLION))
    return buffer.getvalue()


OTHERS: dict[str, Callable[[], bytes]] = {
    "nothing": lambda: b"",
    "blanks": lambda: b" \r\n\t" * 1_000,
    "one byte": lambda: b"\x00",
    "zeros": lambda: bytes(MILLION),
    "ones": lambda: b"\xff" * MILLION,
    "noise": lambda: NOISE,
    "an image": lambda: stored("PNG"),
    "PostScript": lambda: POSTSCRIPT,
    "a zip bomb": archive,
    "a gzip bomb": lambda: gzip.compress(bytes(100 * MILLION)),
    "a pickle": lambda: b"cos\nsystem\n(S'touch /tmp/hostile-upload'\ntR.",
    "a program": lambda: b"\x7fELF\x02\x01\x01" + bytes(200),
    "a script": lambda: b"#!/bin/sh\ntouch /tmp/hostile-upload\n",
    "a web page": lambda: b"<!doctype html><script>alert(1)</script>",
    "entities": lambda: b'<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;">]><a>&c;</a>',
    "nested JSON": lambda: b"[" * MILLION,
    "UTF-16": lambda: "v 0 0 0\nf 1 1 1\n".encode("utf-16"),
}
"""Files that are of no kind."""


def ply(vertices: object, faces: object, body: bytes = b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", form: str = "ascii") -> bytes:
    return PLY_HEADER.format(format=form, vertices=vertices, faces=faces, count="uchar").encode() + body


def off(text: str) -> bytes:
    return f"OFF\n{text}\n".encode()


TEXTS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "8 MB of blank lines": ("obj", lambda: b"\n" * (8 * MILLION) + b"v"),
    "8 MB of lines of blanks": ("obj", lambda: b" \t\n" * (8 * MILLION // 3) + b"v"),
    "8 MB of lines that end in v": ("obj", lambda: b"\n v" * (8 * MILLION // 3)),
    "400,000 materials": ("obj", lambda: CORNERS + b"".join(b"usemtl %d\nf 1 2 3\n" % k for k in range(200_000))),
    "two million faces": ("obj", lambda: CORNERS + b"f 1 2 3\n" * (2 * MILLION)),
    "a face of a million corners": ("obj", lambda: CORNERS + b"f" + b" 1 2 3" * MILLION),
    "four million vertices": ("obj", lambda: b"v 0 0 0\n" * (4 * MILLION) + b"f 1 2 3\n"),
    "four million empty faces": ("obj", lambda: CORNERS + b"f\n" * (4 * MILLION)),
    "a number of a million digits": ("obj", lambda: b"v " + b"9" * MILLION + b" 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "an index beyond 64 bits": ("obj", lambda: CORNERS + b"f 1 2 99999999999999999999999\n"),
    "an index of a million digits": ("obj", lambda: CORNERS + b"f 1 2 " + b"9" * MILLION + b"\n"),
    "an index of zero": ("obj", lambda: CORNERS + b"f 0 1 2\n"),
    "a negative index": ("obj", lambda: CORNERS + b"f -9 -8 -7\n"),
    "an index beyond the vertices": ("obj", lambda: CORNERS + b"f 1 2 4\n"),
    "faces of words": ("obj", lambda: CORNERS + b"f one two three\n"),
    "vertices of words": ("obj", lambda: b"v a b c\n" * 3 + b"f 1 2 3\n"),
    "NUL in text": ("obj", lambda: CORNERS + b"\0f 1 2 3\n"),
    "10¹² vertices": ("ply", lambda: ply(10**12, 1)),
    "10¹² faces": ("ply", lambda: ply(3, 10**12)),
    "-1 vertices": ("ply", lambda: ply(-1, 1)),
    "vertices in words": ("ply", lambda: ply("many", 1)),
    "vertices of a million digits": ("ply", lambda: ply("9" * 4_000, 1)),
    "an index of a ply beyond its vertices": ("ply", lambda: ply(3, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 99\n")),
    "a header of 1 MB": ("ply", lambda: b"ply\nformat ascii 1.0\n" + b"comment x\n" * 100_000 + b"end_header\n"),
    "10,000 properties": (
        "ply",
        lambda: b"ply\nformat ascii 1.0\nelement vertex 3\n" + b"property float x\n" * 10_000 + b"end_header\n0 0 0\n",
    ),
    "an element twice": ("ply", lambda: ply(3, 1).replace(b"element face", b"element vertex 9\nelement face")),
    "an unknown type of a ply": ("ply", lambda: ply(3, 1).replace(b"float x", b"object x")),
    "4 MB of blank lines after a ply": ("ply", lambda: ply(3, 1) + b"\n" * (4 * MILLION)),
    "binary ply cut off": ("ply", lambda: ply(3, 1, b"\0" * 20, "binary_little_endian")),
    "an unknown format of ply": ("ply", lambda: ply(3, 1, form="ternary")),
    "a billion triangles": ("stl", lambda: bytes(80) + struct.pack("<I", 10**9) + bytes(50)),
    "-1 triangles": ("stl", lambda: bytes(80) + struct.pack("<i", -1) + bytes(50)),
    "no triangles": ("stl", lambda: bytes(84)),
    "20,000 solids": ("stl", lambda: ASCII_STL[:300].replace(b"solid", b"solid x") + b"solid a\nendsolid a\n" * 20_000),
    "a solid without an end": ("stl", lambda: ASCII_STL.replace(b"endsolid", b"")),
    "a vertex of two numbers": ("stl", lambda: b"solid\nvertex 0 0\nvertex 1 0 0\nvertex 0 1 0\nendsolid\n"),
    "a million times vertex": ("stl", lambda: b"solid\n" + b"vertex " * MILLION + b"\nendsolid\n"),
    "triangles of NaN": ("stl", lambda: bytes(80) + struct.pack("<I", 9) + b"\xff" * 450),
    "OFF of 10¹² vertices": ("off", lambda: off(f"{10**12} 1 0\n0 0 0")),
    "OFF of 10¹² faces": ("off", lambda: off(f"3 {10**12} 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2")),
    "OFF of -3 vertices": ("off", lambda: off("-3 1 0\n0 0 0")),
    "OFF of words": ("off", lambda: off("three one zero")),
    "OFF of a vertex that is not there": ("off", lambda: off("3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 99")),
    "OFF without numbers": ("off", lambda: b"OFF\n"),
    "OFF of 8 MB of comments": ("off", lambda: b"OFF\n" + b"#\n" * (4 * MILLION)),
}

KIND_NAMES = ("", "OBJ", "fbx", "blend", "../obj", "obj\0", "zip", "stl_ascii", "x" * 100, "ply\r\nx: y", "usd", "пли")

ODD: dict[str, tuple[str, bytes]] = {
    "an OBJ that names files": ("obj", b"mtllib /etc/passwd\nusemtl a\n" + BOXES["obj"]),
    "an OBJ in Latin-1": ("obj", "o Büro\n".encode("latin-1") + BOXES["obj"]),
    "an OBJ with a backslash": ("obj", CORNERS + b"f 1 2 3 \\\n\n"),
    "a PLY that names a texture": (
        "ply",
        ASCII_PLY.replace(b"element vertex", b"comment TextureFile http://127.0.0.1:9/\nelement vertex", 1),
    ),
    "a PLY with a list longer than its line": ("ply", ply(3, 1, b"0 0 0\n1 0 0\n0 1 0\n255 0 1 2\n")),
    "an OFF with a face longer than its line": ("off", off(f"3 1 0\n0 0 0\n1 0 0\n0 1 0\n{10**9} 0 1 2")),
    "an STL whose header is a program": ("stl", b"\x7fELF" + BOXES["stl"][4:]),
    "a texture of a file": ("glb", texture_at("file:///etc/passwd")),
    "a texture of an address": ("glb", texture_at("http://127.0.0.1:9/a.png")),
    "a glb with a script as its name": ("glb", edited_glb(lambda tree: tree["meshes"][0].update(name="<script>"))),
}


def hostile() -> Iterator[tuple[str, Case]]:
    """Yields each file with a name. Other kinds, files cut off and numbers that are none are in test_mesh_reading."""
    for (name, make), kind in zip(OTHERS.items(), cycle(KINDS), strict=False):
        yield f"{name} as {kind}", (kind, make(), "file")
    for name, make in GLB.items():
        yield name, ("glb", make(), "file")
    for name, (kind, make) in TEXTS.items():
        yield name, (kind, make(), "file")
    for kind in KIND_NAMES:
        yield f"the kind {kind!r}", (kind, BOXES["obj"], "kind")
    for name, (kind, data) in ODD.items():
        yield name, (kind, data, None)


IMAGES: dict[str, bytes] = {
    "nothing": b"",
    "noise": NOISE,
    "PostScript": POSTSCRIPT,
    "a BMP": stored("BMP"),
    "a TIFF": stored("TIFF"),
    "a GIF": stored("GIF"),
    "a PNG of another size": stored("PNG"),
    "a PNG of 2⁶² pixels": png_of_size(2**31 - 1, 2**31 - 1),
    "a PNG without pixels": png_of_size(32, 32),
    "a WebP of 2⁴⁸ pixels": vp8x(2**24, 2**24),
    "half a JPEG": stored("JPEG")[:200],
    "a zip bomb": archive(),
}
"""Images to re-render of a scene of 32×32 pixels. None is one."""


def in_base64(data: bytes) -> str:
    """Bytes as the API takes an image."""
    return base64.b64encode(data).decode()
