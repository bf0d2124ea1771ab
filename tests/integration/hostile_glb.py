"""Damaged and lying glTF files: nodes, counts, lengths, references, textures and JSON."""

import random
import struct
from collections.abc import Callable
from typing import Any

from tests.unit.scenes.mesh_files import BOXES, edited_glb, glb
from tests.unit.scenes.test_gltf import damaged_png, one, texture_of
from tests.unit.scenes.test_image_file import POSTSCRIPT, png_of_size, stored, vp8x

MILLION = 10**6


def header_of_glb(length: int, chunk: int, kind: int = 0x4E4F534A) -> bytes:
    return b"glTF" + struct.pack("<IIII", 2, length, chunk, kind)


def text_glb(text: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    return header_of_glb(20 + len(text), len(text)) + text


def changed(**values: Any) -> bytes:
    return edited_glb(lambda tree: tree.update(values))


def primitive(**values: Any) -> bytes:
    return edited_glb(lambda tree: tree["meshes"][0]["primitives"][0].update(values))


def accessor(**values: Any) -> bytes:
    return edited_glb(lambda tree: [one.update(values) for one in tree["accessors"]])


def view(**values: Any) -> bytes:
    return edited_glb(lambda tree: [one.update(values) for one in tree["bufferViews"]])


def textured(data: bytes) -> bytes:
    return one({}, texture_of(data), TEXCOORD_0=[[0, 0]] * 3).glb()


def texture_at(address: str) -> bytes:
    writer = one({}, texture_of(b""), TEXCOORD_0=[[0, 0]] * 3)
    writer.tree["images"][0] = {"uri": address}
    return writer.glb()


def doubling(tree: dict[str, Any]) -> None:
    tree.update(
        nodes=[{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}], scenes=[{"nodes": [0]}], scene=0
    )


def chain(tree: dict[str, Any]) -> None:
    """9,999 nodes, each of which doubles the size of the next."""
    nodes = [{"children": [k + 1], "scale": [2, 2, 2]} for k in range(9_999)]
    tree.update(nodes=[*nodes, {"mesh": 0}], scenes=[{"nodes": [0]}], scene=0)


GLB: dict[str, Callable[[], bytes]] = {
    "cyclic nodes": lambda: changed(nodes=[{"children": [1]}, {"children": [0], "mesh": 0}], scenes=[{"nodes": [0]}]),
    "a node that is its own child": lambda: changed(nodes=[{"children": [0], "mesh": 0}], scenes=[{"nodes": [0]}]),
    "nodes that multiply": lambda: edited_glb(doubling),
    "a chain of scales": lambda: edited_glb(chain),
    "a million nodes": lambda: changed(nodes=[{}] * MILLION),
    "a child that is not there": lambda: changed(nodes=[{"children": [10**9], "mesh": 0}]),
    "a child that is no number": lambda: changed(nodes=[{"children": ["x"], "mesh": 0}]),
    "a mesh that is not there": lambda: changed(nodes=[{"mesh": 10**9}]),
    "a negative mesh": lambda: changed(nodes=[{"mesh": -1}]),
    "a matrix of NaN": lambda: changed(nodes=[{"mesh": 0, "matrix": [float("nan")] * 16}]),
    "a matrix of 15": lambda: changed(nodes=[{"mesh": 0, "matrix": [1] * 15}]),
    "a matrix of zeros": lambda: changed(nodes=[{"mesh": 0, "matrix": [0] * 16}]),
    "a rotation of zero": lambda: changed(nodes=[{"mesh": 0, "rotation": [0, 0, 0, 0]}]),
    "a scale of infinity": lambda: changed(nodes=[{"mesh": 0, "scale": [float("inf")] * 3}]),
    "a million accessors": lambda: changed(accessors=[{}] * MILLION),
    "a million materials": lambda: changed(materials=[{}] * MILLION),
    "a million images": lambda: changed(images=[{}] * MILLION),
    "a million textures": lambda: changed(textures=[{}] * MILLION),
    "a million extensions": lambda: changed(extensionsRequired=["x" * 5] * MILLION),
    "meshes that are no list": lambda: changed(meshes={}),
    "meshes that are strings": lambda: changed(meshes=["mesh"]),
    "a scene that is not there": lambda: changed(scene=99),
    "no scenes, no nodes": lambda: changed(scenes=[], nodes=[]),
    "100,000 primitives": lambda: edited_glb(
        lambda tree: tree["meshes"][0].update(primitives=[{"attributes": {"POSITION": 0}}] * 100_000)
    ),
    "accessors of 10⁹": lambda: accessor(count=10**9),
    "accessors of 2⁶⁴": lambda: accessor(count=2**64),
    "accessors of -1": lambda: accessor(count=-1),
    "accessors of 1.5": lambda: accessor(count=1.5),
    "accessors of text": lambda: accessor(count="many"),
    "an unknown component": lambda: accessor(componentType=1),
    "an unknown type": lambda: accessor(type="MAT9"),
    "accessors beyond their view": lambda: accessor(byteOffset=10**9),
    "accessors before their view": lambda: accessor(byteOffset=-8),
    "sparse accessors": lambda: accessor(sparse={"count": 10**9}),
    "accessors without data": lambda: edited_glb(lambda tree: [one.pop("bufferView") for one in tree["accessors"]]),
    "views beyond their buffer": lambda: view(byteOffset=10**9),
    "views of 10⁹": lambda: view(byteLength=10**9),
    "views of -1": lambda: view(byteLength=-1),
    "views of another buffer": lambda: view(buffer=5),
    "a stride of 0": lambda: view(byteStride=0),
    "a stride of 10⁹": lambda: view(byteStride=10**9),
    "a buffer of 10⁹": lambda: changed(buffers=[{"byteLength": 10**9}]),
    "a buffer of a file": lambda: changed(buffers=[{"byteLength": 36, "uri": "/etc/passwd"}]),
    "a buffer of an address": lambda: changed(buffers=[{"byteLength": 36, "uri": "http://127.0.0.1:9/a"}]),
    "a buffer that is not base64": lambda: changed(buffers=[{"byteLength": 36, "uri": "data:;base64,???"}]),
    "indices that are positions": lambda: primitive(indices=1),
    "indices that are not there": lambda: primitive(indices=10**9),
    "positions that are indices": lambda: primitive(attributes={"POSITION": 0}),
    "no positions": lambda: primitive(attributes={}),
    "attributes that are a list": lambda: primitive(attributes=[]),
    "a mode of 99": lambda: primitive(mode=99),
    "points": lambda: primitive(mode=0),
    "a material that is not there": lambda: primitive(material=10**9),
    "a texture of PostScript": lambda: textured(POSTSCRIPT),
    "a texture of noise": lambda: textured(random.Random(14).randbytes(5_000)),
    "a texture without bytes": lambda: textured(b""),
    "a damaged texture": lambda: textured(damaged_png()),
    "a texture of 2⁶² pixels": lambda: textured(png_of_size(2**31 - 1, 2**31 - 1)),
    "a WebP texture of 2⁴⁸ pixels": lambda: textured(vp8x(2**24, 2**24)),
    "a texture that is a BMP": lambda: textured(stored("BMP")),
    "a texture that is a TIFF": lambda: textured(stored("TIFF")),
    "a texture that is a GIF": lambda: textured(stored("GIF")),
    "JSON of lists": lambda: text_glb(b"[" * MILLION),
    "JSON of objects": lambda: text_glb(b'{"a":' * MILLION),
    "JSON of a number of a million digits": lambda: text_glb(b"9" * MILLION),
    "JSON of text": lambda: text_glb(b'"text"'),
    "JSON of null": lambda: text_glb(b"null"),
    "JSON that is no UTF-8": lambda: text_glb(b'{"a": "\xff\xfe"}'),
    "JSON cut off": lambda: text_glb(b'{"asset": {"version":'),
    "a chunk of 4 GB": lambda: header_of_glb(20, 2**32 - 1),
    "a length of 4 GB": lambda: header_of_glb(2**32 - 1, 0),
    "glTF 1": lambda: BOXES["glb"][:4] + struct.pack("<I", 1) + BOXES["glb"][8:],
    "no JSON": lambda: header_of_glb(20, 0, 0x004E4942),
    "an empty tree": lambda: glb({}),
}
