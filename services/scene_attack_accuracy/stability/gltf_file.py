"""glTF files written byte by byte from the specification, without the project's glTF reader, so that a mistake in the
reader is not repeated here.
"""

import json
import struct
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Arrays = Mapping[str, NDArray[Any]]
_FLOAT, _UNSIGNED = 5126, 5125
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Writer:
    """Collects the parts of a GLB file; `tree` is its JSON."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
        self._body = b""

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Appends an entry to a top-level array of the JSON and returns its index."""
        self.tree.setdefault(kind, []).append(entry)
        return len(self.tree[kind]) - 1

    def data(self, values: bytes) -> int:
        """Adds a buffer view with these bytes and returns its index."""
        view = {"buffer": 0, "byteOffset": len(self._body), "byteLength": len(values)}
        self._body += values + b"\0" * (-len(values) % 4)
        return self.add("bufferViews", view)

    def accessor(self, values: NDArray[Any]) -> int:
        """Adds an accessor of float32 attributes [n, columns] or of indices [n], and returns its index."""
        indices = values.ndim == 1
        stored = np.ascontiguousarray(values, np.uint32 if indices else np.float32)
        entry = {
            "bufferView": self.data(stored.tobytes()),
            "componentType": _UNSIGNED if indices else _FLOAT,
            "count": len(stored),
            "type": _TYPES[1 if indices else stored.shape[1]],
            "min": np.atleast_1d(stored.min(axis=0)).tolist(),
            "max": np.atleast_1d(stored.max(axis=0)).tolist(),
        }
        return self.add("accessors", entry)

    def texture(self, texels: NDArray[np.uint8], **info: Any) -> dict[str, Any]:
        """Adds an image, uint8 [h, w, 3 or 4], as PNG, and returns a reference to its texture."""
        stored = BytesIO()
        Image.fromarray(texels).save(stored, "PNG")
        image = self.add("images", {"bufferView": self.data(stored.getvalue()), "mimeType": "image/png"})
        return {"index": self.add("textures", {"source": image}), **info}

    def primitive(self, arrays: Arrays, material: dict[str, Any] | None) -> dict[str, Any]:
        """A primitive of the attributes and "indices" in `arrays`."""
        attributes = {name: self.accessor(values) for name, values in arrays.items() if name != "indices"}
        entry: dict[str, Any] = {"attributes": attributes, "indices": self.accessor(arrays["indices"])}
        if material is not None:
            entry["material"] = self.add("materials", material)
        return entry

    def mesh(self, *primitives: dict[str, Any]) -> int:
        """A mesh of these primitives."""
        return self.add("meshes", {"primitives": list(primitives)})

    def root(self, **node: Any) -> None:
        """A node of the scene."""
        self.tree["scenes"][0]["nodes"].append(self.add("nodes", node))

    def glb(self) -> bytes:
        """The file."""
        self.tree["buffers"] = [{"byteLength": len(self._body)}]
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self._body), 0x004E4942) + self._body
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def file_of(arrays: Arrays, material: Mapping[str, Any], **node: Any) -> bytes:
    """A GLB file of one node with one primitive. `arrays` are its attributes [V, columns] and its "indices" [3 F].

    `material` is as in the file, but that in place of a texture's index there is its image: uint8 [h, w, 3 or 4], or
    that as "image" beside the other properties.
    """
    writer = Writer()

    def written(value: Any) -> Any:
        if isinstance(value, Mapping):
            more = {name: written(of) for name, of in value.items() if name != "image"}
            return more | (written(value["image"]) if "image" in value else {})
        return writer.texture(value) if isinstance(value, np.ndarray) else value

    writer.root(mesh=writer.mesh(writer.primitive(arrays, written(material))), **node)
    return writer.glb()
