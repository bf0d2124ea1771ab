"""Small glTF files, written byte by byte from the specification, and not by what reads them."""

import json
import struct
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

from services.scenes.mesh import Doubles

_FLOAT, _UNSIGNED = 5126, 5125


def file_of(arrays: Mapping[str, Doubles], material: dict[str, Any], **node: Any) -> bytes:
    """A GLB file of one node with one primitive. `arrays` are its attributes [V, columns] and its "indices" [3 F].

    `material` is as in the file, but that in place of a texture's index there is its image: uint8 [h, w, 3 or 4], or
    that as "image" beside the other properties.
    """
    tree: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0} | node],
        **{kind: [] for kind in ("accessors", "bufferViews", "textures", "images")},
    }
    body = b""

    def view(data: bytes) -> int:
        nonlocal body
        tree["bufferViews"].append({"buffer": 0, "byteOffset": len(body), "byteLength": len(data)})
        body += data + b"\0" * (-len(data) % 4)
        return len(tree["bufferViews"]) - 1

    def accessor(values: Doubles) -> int:
        whole = values.ndim == 1
        stored = values.astype("<u4" if whole else "<f4")
        entry = {
            "bufferView": view(stored.tobytes()),
            "count": len(stored),
            "componentType": _UNSIGNED if whole else _FLOAT,
            "type": "SCALAR" if whole else f"VEC{stored.shape[1]}",
        }
        tree["accessors"].append(entry | {"min": np.atleast_1d(stored.min(0)).tolist()})
        return len(tree["accessors"]) - 1

    def texture(value: Any) -> Any:
        if isinstance(value, dict):
            more = {name: texture(of) for name, of in value.items() if name != "image"}
            return more | (texture(value["image"]) if "image" in value else {})
        if not isinstance(value, np.ndarray):
            return value
        png = BytesIO()
        Image.fromarray(value).save(png, "PNG")
        tree["images"].append({"bufferView": view(png.getvalue()), "mimeType": "image/png"})
        tree["textures"].append({"source": len(tree["images"]) - 1})
        return {"index": len(tree["textures"]) - 1}

    attributes = {name: accessor(values) for name, values in arrays.items() if name != "indices"}
    primitive = {"attributes": attributes, "indices": accessor(arrays["indices"]), "material": 0}
    tree |= {"meshes": [{"primitives": [primitive]}], "materials": [texture(material)]}
    tree["buffers"] = [{"byteLength": len(body)}]
    tree = {name: value for name, value in tree.items() if value != []}
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def square_arrays(**more: Any) -> dict[str, Doubles]:
    """A square of side 2 in z = 0 that faces +z, u to the right and v down from its upper left corner; with or instead
    of these, `more` arrays."""
    return {
        "POSITION": np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float64),
        "NORMAL": np.tile([0.0, 0.0, 1.0], (4, 1)),
        "TEXCOORD_0": np.array([(0, 1), (1, 1), (1, 0), (0, 0)], np.float64),
        "indices": np.array([0, 1, 2, 0, 2, 3]),
    } | {name: np.array(values) for name, values in more.items()}
