"""Writes binary glTF 2.0 files (.glb): JSON, and the bytes of vertices and images that it refers to."""

import json
import struct
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from services.scenes.mesh import Bytes

_COMPONENTS = {np.dtype(np.float32): 5126, np.dtype(np.uint32): 5125}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
VERTICES, INDICES = 34962, 34963
"""OpenGL's targets of a buffer view."""
_LINEAR, _MIPMAPS = 9729, 9987
_JSON, _BIN = 0x4E4F534A, 0x004E4942


class Glb:
    """A file that is being made: lists of its JSON, which callers fill, and the bytes behind them.

    An array or image that is added twice is stored once.
    """

    def __init__(self, extras: Mapping[str, Any]) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "scene-attack", "extras": dict(extras)},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
        }
        self._bytes = bytearray()
        self._made: dict[tuple[Any, ...], int] = {}
        self._derived: dict[int, NDArray[Any]] = {}
        self._alive: list[NDArray[Any]] = []
        """The arrays whose ids are keys: an id is another array's once its own is gone."""

    def add(self, what: str, entry: Mapping[str, Any]) -> int:
        """Appends an entry to the list `what` of the JSON ("nodes", "materials", …); returns its index there."""
        entries: list[dict[str, Any]] = self.json.setdefault(what, [])
        entries.append(dict(entry))
        return len(entries) - 1

    def uses(self, extension: str) -> None:
        """Notes that the file uses an extension that a reader may pass over."""
        used = self.json.setdefault("extensionsUsed", [])
        if extension not in used:
            used.append(extension)

    def kept(self, source: NDArray[Any], derive: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """What `derive` makes of the array `source`, made once and kept alive, so that it is stored once."""
        if id(source) not in self._derived:
            self._derived[id(source)] = derive()
            self._alive.append(source)
        return self._derived[id(source)]

    def accessor(self, values: NDArray[Any], target: int = VERTICES) -> int:
        """The accessor of an array of float32 or uint32, [n] or [n, 2 to 4]."""
        key = ("accessor", id(values))
        if key not in self._made:
            entry = {
                "bufferView": self._view(np.ascontiguousarray(values).tobytes(), target),
                "componentType": _COMPONENTS[values.dtype],
                "count": len(values),
                "type": _KINDS[values.shape[1] if values.ndim == 2 else 1],
            }
            if values.ndim == 2 and values.shape[1] == 3:  # required of positions
                entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
            self._made[key] = self.add("accessors", entry)
            self._alive.append(values)
        return self._made[key]

    def texture(self, texels: Bytes, wrap: tuple[int, int]) -> int:
        """The texture of texels uint8 [h, w, 4], row 0 at the top, repeated as OpenGL's modes `wrap` of u and v say.

        The image is a PNG file, without alpha where all texels are opaque.
        """
        key = ("texture", id(texels), wrap)
        if key not in self._made:
            image = ("image", id(texels))
            if image not in self._made:
                self._alive.append(texels)
                view = self._view(_png(texels), None)
                self._made[image] = self.add("images", {"bufferView": view, "mimeType": "image/png"})
            sampler = ("sampler", wrap)
            if sampler not in self._made:
                filters = {"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": wrap[0], "wrapT": wrap[1]}
                self._made[sampler] = self.add("samplers", filters)
            entry = {"source": self._made[image], "sampler": self._made[sampler]}
            self._made[key] = self.add("textures", entry)
        return self._made[key]

    def written(self) -> bytes:
        """The file."""
        if self._bytes:
            self.json["buffers"] = [{"byteLength": len(self._bytes)}]
        text = json.dumps(self.json, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), _JSON) + text
        if self._bytes:
            chunks += struct.pack("<II", len(self._bytes), _BIN) + bytes(self._bytes)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _view(self, data: bytes, target: int | None) -> int:
        start = len(self._bytes)
        self._bytes += data + bytes(-len(data) % 4)
        entry = {"buffer": 0, "byteOffset": start, "byteLength": len(data)}
        return self.add("bufferViews", entry if target is None else entry | {"target": target})


def _png(texels: Bytes) -> bytes:
    opaque = bool((texels[..., 3] == 255).all())
    buffer = BytesIO()
    Image.fromarray(np.ascontiguousarray(texels[..., :3] if opaque else texels)).save(buffer, format="PNG")
    return buffer.getvalue()
