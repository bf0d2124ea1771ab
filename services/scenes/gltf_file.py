"""Reads a glTF 2.0 file, binary or not: its JSON, its accessors as arrays, its images (Khronos, glTF 2.0, 3.6)."""

import base64
import struct
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from services.scenes.beside import Beside
from services.scenes.image_file import open_image
from services.scenes.mesh import Doubles, Longs
from services.scenes.unreadable import Unreadable
from services.strict import NotJson, read_json

READ_EXTENSIONS = ("KHR_mesh_quantization", "EXT_texture_webp")
"""glTF extensions that are supported and that a file may therefore require."""

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives that have triangles. 0 to 3 are points and lines."""

_TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_BASE64 = ";base64,"


class MissingFile(Unreadable):
    """A buffer or image is in a file that was not sent with the glTF file."""


class GltfFile:
    """The elements of a glTF file. Every method raises Unreadable, which names the element, if it is invalid."""

    def __init__(self, data: bytes, beside: Beside | None = None) -> None:
        """Reads a GLB, or JSON whose buffers and images may be in files of `beside`.

        Raises Unreadable if `data` is not in the chunks of a glTF 2 file or requires an unsupported extension.
        """
        self._binary = b""
        self._beside = beside or Beside({})
        tree: Any = None if data.startswith(b"glTF") else json_of(data)
        position = 12 if tree is None else len(data)
        while position + 8 <= len(data):
            length, kind = struct.unpack_from("<II", data, position)
            chunk = data[position + 8 : position + 8 + length]
            if tree is None:
                if kind != _JSON:
                    raise Unreadable("its first chunk is not JSON")
                tree = json_of(chunk)
            elif kind == _BINARY and not self._binary:
                self._binary = chunk
            position += 8 + length
        if not isinstance(tree, dict):
            raise Unreadable("its JSON is not an object")
        self.tree: dict[str, Any] = tree
        unread = [name for name in self.array("extensionsRequired") if name not in READ_EXTENSIONS]
        if unread:
            names = ", ".join(str(name) for name in unread)
            raise Unreadable(f"it requires the extension {names} (extensionsRequired), which is not read")
        self._images: dict[tuple[str, int], Image.Image] = {}

    def array(self, name: str) -> list[Any]:
        """Returns a top-level array of the JSON; empty if the JSON does not have it."""
        entries = self.tree.get(name, [])
        if not isinstance(entries, list):
            raise Unreadable(f"its {name} are not a list")
        return entries

    def item(self, name: str, index: Any) -> dict[str, Any]:
        """Returns an element of a top-level array."""
        entries = self.array(name)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(entries):
            raise Unreadable(f"it refers to {name}[{index!r}], which is not there")
        if not isinstance(entries[index], dict):
            raise Unreadable(f"{name}[{index}] is not an object")
        entry: dict[str, Any] = entries[index]
        return entry

    def items(self, name: str) -> list[dict[str, Any]]:
        """Returns a top-level array of objects; empty if the JSON does not have it."""
        return [self.item(name, index) for index in range(len(self.array(name)))]

    def primitives(self, mesh: Any) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
        """Returns the primitives of a mesh that have triangles: where each is, the primitive, and its attributes.

        The attributes have POSITION. Points and lines are left out.
        """
        primitives = []
        for k, entry in enumerate(elements(self.item("meshes", mesh), "primitives", f"meshes[{mesh}]")):
            where = f"meshes[{mesh}].primitives[{k}]"
            if not isinstance(entry, dict):
                raise Unreadable(f"{where} is not an object")
            mode = entry.get("mode", TRIANGLES)
            if mode not in range(7):
                raise Unreadable(f"{where}.mode is {mode!r}; glTF has 0 to 6")
            if mode not in (TRIANGLES, STRIP, FAN):
                continue
            attributes = entry.get("attributes")
            if not isinstance(attributes, dict) or "POSITION" not in attributes:
                raise Unreadable(f"{where} has no attributes.POSITION, the accessor of its vertices")
            primitives.append((where, entry, attributes))
        return primitives

    def count(self, index: Any) -> int:
        """Returns the number of elements that an accessor declares."""
        return size(self.item("accessors", index).get("count"), f"accessors[{index}].count")

    def values(self, index: Any, columns: tuple[int, ...]) -> Doubles:
        """Returns an accessor's values, float64 [count, columns]; normalized integers are mapped to [0,1] or [-1,1]."""
        stored = self._array(index, columns)
        if not self.item("accessors", index).get("normalized", False) or stored.dtype == np.float32:
            return stored.astype(np.float64)
        return np.maximum(stored / float(np.iinfo(stored.dtype).max), -1.0)

    def indices(self, index: Any) -> Longs:
        """Returns the values of an accessor of unsigned integers, int64 [count]."""
        stored = self._array(index, (1,))
        if stored.dtype.kind != "u":
            raise Unreadable(f"accessors[{index}] holds indices, but not as unsigned integers")
        return stored[:, 0].astype(np.int64)

    def image(self, index: Any) -> Image.Image:
        """Returns an image, not yet decoded; images of the same bytes in the file are one object."""
        entry = self.item("images", index)
        uri = str(entry.get("uri", ""))
        view = entry.get("bufferView")
        key = ("images", index) if view is None else ("bufferViews", size(view, f"images[{index}].bufferView"))
        if key not in self._images:
            if view is None:
                data = self._at(entry.get("uri"), f"images[{index}]")
            else:
                data = self._view(self.item("bufferViews", view), view)
            try:
                self._images[key] = open_image(data)
            except Unreadable as error:
                name = "" if view is not None or uri.startswith("data:") else f" ({uri[:100]})"
                raise Unreadable(f"images[{index}]{name} is not a readable image: {error}") from error
        return self._images[key]

    def _array(self, index: Any, columns: tuple[int, ...]) -> NDArray[Any]:
        accessor = self.item("accessors", index)
        where = f"accessors[{index}]"
        kind, width, count = accessor.get("componentType"), _width(accessor), self.count(index)
        if not isinstance(kind, int) or kind not in _TYPES or width is None or width not in columns:
            names = " or ".join(name for name, width in _COLUMNS.items() if width in columns)
            raise Unreadable(f"{where} has the type {accessor.get('type')!r} of {kind!r} where {names} is due")
        if "sparse" in accessor:
            raise Unreadable(f"{where} is sparse, which is not read")
        dtype = np.dtype(_TYPES[kind])
        view = self.item("bufferViews", accessor.get("bufferView"))
        data = self._view(view, accessor["bufferView"])
        offset = size(accessor.get("byteOffset", 0), f"{where}.byteOffset")
        packed = dtype.itemsize * width
        stride = size(view.get("byteStride", packed), f"bufferViews[{accessor['bufferView']}].byteStride")
        if stride < packed or count < 1 or offset + (count - 1) * stride + packed > len(data):
            raise Unreadable(f"{where} has {count!r} elements, which its buffer view does not hold")
        rows = np.ndarray((count, packed), np.uint8, data, offset, (stride, 1))
        return np.ascontiguousarray(rows).view(dtype.newbyteorder("<")).reshape(count, width).astype(dtype)

    def _view(self, view: dict[str, Any], index: int) -> bytes:
        where = f"bufferViews[{index}]"
        buffer = self._buffer(view.get("buffer"))
        start = size(view.get("byteOffset", 0), f"{where}.byteOffset")
        length = size(view.get("byteLength"), f"{where}.byteLength")
        if start + length > len(buffer):
            raise Unreadable(f"{where} reaches beyond its buffer")
        return buffer[start : start + length]

    def _buffer(self, index: Any) -> bytes:
        entry = self.item("buffers", index)
        if index not in self._buffers:
            chunk = index == 0 and "uri" not in entry
            content = self._binary if chunk else self._at(entry.get("uri"), f"buffers[{index}]")
            length = size(entry.get("byteLength"), f"buffers[{index}].byteLength")
            if length > len(content):
                raise Unreadable(f"buffers[{index}].byteLength is {length:,}, which is more than the file holds")
            self._buffers[index] = content[:length]
        return self._buffers[index]

    def _at(self, uri: Any, where: str) -> bytes:
        """Returns the bytes of a data URI, or of a file that came with this one. Nothing is fetched."""
        if not isinstance(uri, str):
            raise Unreadable(f"{where} has neither data nor the name of a file")
        if uri.startswith("data:") and _BASE64 in uri:
            try:
                return base64.b64decode(uri.split(_BASE64, 1)[1], validate=True)
            except ValueError as error:  # binascii.Error, or characters beyond ASCII
                raise Unreadable(f"{where} is not base64") from error
        if (path := self._beside.find(uri)) is None:
            raise MissingFile(f"{where} is in the file {uri[:100]!r}, which was not sent")
        return self._beside.data(path)

    @cached_property
    def _buffers(self) -> dict[int, bytes]:
        return {}


def json_of(data: bytes) -> Any:
    """Returns the JSON of a glTF file. Raises Unreadable."""
    try:
        return read_json(data)
    except NotJson as error:
        raise Unreadable(f"its JSON cannot be read: {error}") from error


def _width(accessor: dict[str, Any]) -> int | None:
    kind = accessor.get("type")
    return _COLUMNS.get(kind) if isinstance(kind, str) else None


def size(value: Any, where: str) -> int:
    """Returns a size, a count or an offset. Raises Unreadable, which names it, for other than integers from 0."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise Unreadable(f"{where} is {value!r}, which is not an integer of at least 0")
    return value


def elements(entry: dict[str, Any], name: str, where: str) -> list[Any]:
    """Returns a property that is a list; empty if it is left out. Raises Unreadable, which names it, for others."""
    entries = entry.get(name, [])
    if not isinstance(entries, list):
        raise Unreadable(f"{where}.{name} is not a list")
    return entries


def numbers(
    entry: dict[str, Any], name: str, default: tuple[float, ...], low: float, high: float, where: str
) -> Doubles:
    """Returns a property that is a list of finite numbers in [low, high], as long as `default`; float64.

    Raises Unreadable, which names the property, for any other value.
    """
    values = entry.get(name, default)
    if not isinstance(values, list | tuple) or len(values) != len(default):
        raise Unreadable(f"{where}.{name} is not a list of {len(default)} numbers")
    return np.array([_checked(value, low, high, f"{where}.{name}") for value in values])


def number(entry: Any, name: str, default: float, low: float, high: float, where: str) -> float:
    """Returns a property that is a single finite number in [low, high]. Raises Unreadable, which names the property."""
    if not isinstance(entry, dict):
        raise Unreadable(f"{where} is not an object")
    return _checked(entry.get(name, default), low, high, f"{where}.{name}")


def _checked(value: Any, low: float, high: float, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise Unreadable(f"{where} is {value!r} where a finite number is due")
    if not low <= value <= high:
        raise Unreadable(f"{where} is {value:g}, which is not in [{low:g}, {high:g}]")
    return float(value)
