"""Reads a glTF 2.0 file, binary or not: its JSON, its accessors as arrays, its images (Khronos, glTF 2.0, 3.6); then as
the parts of a mesh: every triangle of its scene, transformed, with its material.

Vertices are not smoothed or welded and faces are not flipped: glTF states normals, winding and tangents, and
defines the defaults where they are left out (flat normals; tangents along the texture). Materials are
metallic-roughness. Khronos, glTF 2.0 specification, 3.5 to 3.9.
"""

import base64
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from math import cos, inf, isfinite, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scene_attack.errors import Unreadable
from scene_attack.scenes.image_file import FORMATS, open_image
from scene_attack.scenes.mesh import (
    AlphaMode,
    Doubles,
    Floats,
    Longs,
    MapName,
    MaterialSettings,
    MetallicRoughness,
    Part,
    TextureMap,
    ball,
    check_size,
    fitted,
)
from scene_attack.scenes.reading.companion_files import CompanionFiles
from scene_attack.scenes.reading.normals import derive_tangents
from scene_attack.scenes.reading.surfaces import MAX_COORDINATE, Textures, rounding_note
from scene_attack.strict import NotJson, read_json

TRANSFORM = "KHR_texture_transform"
READ_EXTENSIONS = ("KHR_mesh_quantization", "EXT_texture_webp", TRANSFORM)
"""glTF extensions that are supported in a mesh."""
LIGHTS = "KHR_lights_punctual"
"""The extension with a scene's lights. A file may require it, as those of Blender do; a mesh has no use for it."""

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

    def __init__(self, data: bytes, beside: CompanionFiles | None = None) -> None:
        """Reads a GLB, or JSON whose buffers and images may be in files of `beside`.

        Raises Unreadable if `data` is not in the chunks of a glTF 2 file or requires an unsupported extension.
        """
        self._binary = b""
        self._beside = beside or CompanionFiles({})
        self.held = len(data) + self._beside.size
        """Bytes of the file and of those beside it."""
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
        unread = [name for name in self.array("extensionsRequired") if name not in (*READ_EXTENSIONS, LIGHTS)]
        if unread:
            names = ", ".join(str(name) for name in unread)
            raise Unreadable(f"it requires the extension {names} (extensionsRequired), which is not read")
        self._images: dict[tuple[str, int], Image.Image] = {}
        self._buffers: dict[int, bytes] = {}

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


_WRAPS = (10497, 33071, 33648)
_MODES: tuple[AlphaMode, ...] = ("OPAQUE", "MASK", "BLEND")


class _Coordinates(NamedTuple):
    """Texture coordinates: a set of the file, and what moves them: two rows of a linear part and an offset."""

    uv_set: int
    moved: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


_AS_STORED = (_Coordinates(0), _Coordinates(1))


@dataclass(frozen=True, eq=False)
class Material(MaterialSettings):
    """A material of a glTF file, with glTF's defaults. color: float32 [4], the base colour factor, linear RGBA.
    coordinates: the two sets of texture coordinates that `maps` name."""

    color: Floats
    coordinates: tuple[_Coordinates, _Coordinates]


def read_material(file: GltfFile, index: Any, textures: Textures) -> Material:
    """Reads materials[index]; None is glTF's default material: white, metallic 1, roughness 1.

    Raises Unreadable, which names the property, for factors that are not finite or out of range, unknown alpha modes,
    and textures that are not images.
    """
    entry = {} if index is None else file.item("materials", index)
    where = "material" if index is None else f"materials[{index}]"
    surface = entry.get("pbrMetallicRoughness", {})
    if not isinstance(surface, dict):
        raise Unreadable(f"{where}.pbrMetallicRoughness is not an object")
    inner = f"{where}.pbrMetallicRoughness"
    mode = entry.get("alphaMode", "OPAQUE")
    if mode not in _MODES:
        raise Unreadable(f"{where}.alphaMode is {mode!r}; glTF has {', '.join(_MODES)}")
    double_sided = entry.get("doubleSided", False)
    if not isinstance(double_sided, bool):
        raise Unreadable(f"{where}.doubleSided is {double_sided!r}, which is neither true nor false")
    color = numbers(surface, "baseColorFactor", (1.0, 1.0, 1.0, 1.0), 0, 1, inner).astype(np.float32)
    if mode == "OPAQUE":
        color[3] = 1.0
    red, green, blue = numbers(entry, "emissiveFactor", (0.0, 0.0, 0.0), 0, 1, where)
    maps: dict[MapName, TextureMap] = {}
    wanted: dict[MapName, _Coordinates] = {}
    places: tuple[tuple[MapName, dict[str, Any], str], ...] = (
        ("base_color", surface, "baseColorTexture"),
        ("metallic_roughness", surface, "metallicRoughnessTexture"),
        ("normal", entry, "normalTexture"),
        ("occlusion", entry, "occlusionTexture"),
        ("emissive", entry, "emissiveTexture"),
    )
    for name, owner, key in places:
        if key in owner:
            with suppress(MissingFile):  # it is drawn without, and the upload's answer says so
                place = f"{inner if owner is surface else where}.{key}"
                maps[name], wanted[name] = _map(file, owner[key], textures, place)
    coordinates = list(_AS_STORED)
    if not set(wanted.values()) <= set(_AS_STORED):
        coordinates = list(dict.fromkeys(wanted.values()))
    if len(coordinates) > 2:
        raise Unreadable(f"{where} has maps at {len(coordinates)} different places ({TRANSFORM}); two are read")
    maps = {name: replace(one, uv_set=coordinates.index(wanted[name])) for name, one in maps.items()}
    return Material(
        color=color,
        coordinates=(coordinates[0], coordinates[-1]),
        metallic=number(surface, "metallicFactor", 1.0, 0, 1, inner),
        roughness=number(surface, "roughnessFactor", 1.0, 0, 1, inner),
        emissive=(float(red), float(green), float(blue)),
        alpha_mode=mode,
        alpha_cutoff=number(entry, "alphaCutoff", 0.5, 0, inf, where),
        double_sided=double_sided,
        normal_scale=number(entry.get("normalTexture", {}), "scale", 1.0, -1e3, 1e3, f"{where}.normalTexture"),
        occlusion_strength=number(
            entry.get("occlusionTexture", {}), "strength", 1.0, 0, 1, f"{where}.occlusionTexture"
        ),
        maps=maps,
    )


def _map(file: GltfFile, info: Any, textures: Textures, where: str) -> tuple[TextureMap, _Coordinates]:
    if not isinstance(info, dict):
        raise Unreadable(f"{where} is not an object")
    uv_set = info.get("texCoord", 0)
    moved = _Coordinates(0).moved
    extensions = info.get("extensions", {})
    if isinstance(extensions, dict) and TRANSFORM in extensions:
        moved = _moved(transform := extensions[TRANSFORM], f"{where}.extensions.{TRANSFORM}")
        uv_set = transform.get("texCoord", uv_set)
    if uv_set not in (0, 1):
        raise Unreadable(f"{where}.texCoord is {uv_set!r}; TEXCOORD_0 and TEXCOORD_1 are read")
    texture = file.item("textures", info.get("index"))
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source")
    source = texture.get("source", webp)
    if source is None:
        raise Unreadable(f"{where} has no image in {FORMATS}")
    sampler = file.item("samplers", texture["sampler"]) if "sampler" in texture else {}
    wrap = sampler.get("wrapS", _WRAPS[0]), sampler.get("wrapT", _WRAPS[0])
    if not all(mode in _WRAPS for mode in wrap):
        raise Unreadable(f"{where} wraps as {wrap!r}; glTF has {', '.join(map(str, _WRAPS))}")
    try:
        texels = textures.read(file.image(source))
    except (OSError, SyntaxError) as error:  # its header is intact, its data is not
        raise Unreadable(f"{where}: images[{source}] is not a readable {FORMATS} image") from error
    return TextureMap(texels, uv_set, wrap), _Coordinates(uv_set, moved)


def _moved(transform: Any, where: str) -> tuple[float, ...]:
    """Returns what KHR_texture_transform does to coordinates (v downwards): scaled, turned, and moved."""
    angle = number(transform, "rotation", 0.0, -1e3, 1e3, where)
    (across, down), (x, y) = (
        numbers(transform, name, default, -1e6, 1e6, where)
        for name, default in (("scale", (1.0, 1.0)), ("offset", (0.0, 0.0)))
    )
    turned = (cos(angle) * across, sin(angle) * down, x, -sin(angle) * across, cos(angle) * down, y)
    return tuple(float(value) for value in turned)


_MAX_NODES = 10_000
_MAX_ELEMENTS = {
    "accessors": 50_000,
    "bufferViews": 50_000,
    "buffers": 100,
    "images": 256,
    "materials": 1_000,
    "meshes": 10_000,
    "samplers": 1_000,
    "scenes": 100,
    "textures": 1_000,
}
"""Largest length of each top-level array of a glTF file."""
_MAX_PRIMITIVES = 10_000
"""Largest number of primitives of all meshes of a glTF file together."""
MAX_PARTS = 2_000
"""Largest number of primitives in the scene; each is a part, which is drawn by itself."""
MAX_TEXELS = 2**29
"""Bytes of all maps of all parts. A processed mesh on the disk holds a map once for each part that has it."""
_MIN_HEIGHT = 1e-6
"""Ratio of a triangle's height to its longest edge below which a normal from float32 coordinates is noise."""


def check_glb(data: bytes, _: int) -> None:
    """Raises Unreadable for what is no whole binary file of glTF 2, by its header."""
    if data[:4] != b"glTF":
        raise Unreadable("it does not begin with glTF")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise Unreadable(f"it is a file of glTF {version}; files of glTF 2 are read")
    if length != len(data):
        raise Unreadable(f"its header says that it has {length:,} bytes, but it has {len(data):,}; is it complete?")


def check_gltf(data: bytes, _: int) -> None:
    """Raises Unreadable for what is no JSON of glTF 2."""
    text = data.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not text.startswith(b"{"):
        raise Unreadable("it does not begin with an object of JSON")
    asset = json_of(text).get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if not str(version).startswith("2"):
        raise Unreadable(f"it is a file of glTF {version!r}; files of glTF 2 are read")


def check_elements(file: GltfFile, max_faces: int) -> None:
    """Counts what a glTF file declares.

    Raises Unreadable, which names the element, for more than the limits, and for nodes that are no tree.
    """
    for name, most in _MAX_ELEMENTS.items():
        if len(file.array(name)) > most:
            raise Unreadable(f"it has {len(file.array(name)):,} {name}; at most {most:,} are taken")
    if any("bufferView" not in accessor for accessor in file.items("accessors")):
        raise Unreadable("it has accessors without data (compressed geometry is not read)")
    views = enumerate(file.items("bufferViews"))
    if sum(size(view.get("byteLength"), f"bufferViews[{k}].byteLength") for k, view in views) > 4 * file.held:
        raise Unreadable("its buffer views declare more than the file holds")
    nodes = file.items("nodes")
    children = [
        size(c, f"nodes[{k}].children") for k, n in enumerate(nodes) for c in elements(n, "children", f"nodes[{k}]")
    ]
    if len(nodes) > _MAX_NODES or len(set(children)) != len(children):
        raise Unreadable(f"its nodes are not a tree of at most {_MAX_NODES:,}")
    primitives = sum(len(elements(mesh, "primitives", f"meshes[{k}]")) for k, mesh in enumerate(file.items("meshes")))
    if primitives > _MAX_PRIMITIVES:
        raise Unreadable(f"it has {primitives:,} primitives; at most {_MAX_PRIMITIVES:,} are taken")
    corners, vertices = 0, 0
    for mesh in range(len(file.array("meshes"))):
        for where, primitive, attributes in file.primitives(mesh):
            position = file.count(attributes["POSITION"])
            for name, accessor in attributes.items():
                if file.count(accessor) != position:
                    raise Unreadable(f"{where} has {file.count(accessor):,} of {name} for {position:,} vertices")
            corners += file.count(primitive["indices"]) if "indices" in primitive else position
            vertices += position
    # Every primitive is counted as a triangle list; a strip of the same length has more, which the reader counts.
    # They may share an accessor of vertices, but the parser copies it for each.
    check_size(max_faces, corners // 3, vertices // 8)


class PlacedNode(NamedTuple):
    """A node of a file's scene: its number in the file and its properties, the place of its parent among the nodes, or
    None, and its world matrix [4,4]."""

    number: int
    entry: dict[str, Any]
    parent: int | None
    transform: Doubles


class Placement(NamedTuple):
    """Where a file's parts are: its nodes, the place of each part's node among them, the parts fitted to the frame,
    and the middle [3] and radius of the ball that holds them, in metres."""

    nodes: list[PlacedNode]
    owners: list[int]
    parts: tuple[Part, ...]
    centre: Doubles
    radius: float


def read_gltf(
    file: GltfFile,
    max_faces: int,
    note: Callable[[str], None] = lambda _: None,
    place: Callable[[Placement], None] = lambda _: None,
) -> tuple[Part, ...]:
    """Returns the parts of a file's scene, fitted to the frame; alpha-blended parts come last. `note` is given what
    is not shown, `place` where the parts are in the file.

    Raises Unreadable, which names the element of the file, for invalid elements (`GltfFile`, `read_material`), for
    vertices that are not finite or beyond MAX_COORDINATE, and for no triangle with an area; TooLarge for more than
    `max_faces` triangles.
    """
    check_elements(file, max_faces)
    nodes = list(_placed_nodes(file))
    placed = [(k, node.entry["mesh"], node.transform) for k, node in enumerate(nodes) if "mesh" in node.entry]
    primitives: dict[int, list[_Primitive]] = {}
    textures = Textures()
    materials: dict[Any, Material] = {}
    count = 0
    for _, index, _ in placed:
        if index not in primitives:
            read = (_primitive(file, *entry) for entry in file.primitives(index))
            primitives[index] = [primitive for primitive in read if primitive is not None]
        count += sum(len(primitive.faces) for primitive in primitives[index])
    check_size(max_faces, count)
    parts: list[_Primitive] = []
    owners: list[int] = []
    if (total := sum(len(primitives[index]) for _, index, _ in placed)) > MAX_PARTS:
        raise Unreadable(f"its scene has {total:,} primitives; at most {MAX_PARTS:,} are taken")
    for owner, index, transform in placed:
        for primitive in primitives[index]:
            key = primitive.material
            if key not in materials:
                materials[key] = read_material(file, key, textures)
            parts.append(primitive.placed(transform))
            owners.append(owner)
    if not parts:
        raise Unreadable("it has no triangles")
    _check_texels([materials[primitive.material] for primitive in parts])
    placement = _fitted(nodes, parts, owners, [materials[primitive.material] for primitive in parts], note)
    place(placement)
    return placement.parts


class _Primitive:
    """Triangles with their vertex attributes, all float64: in their node's frame, then in the file's."""

    def __init__(self, vertices: Doubles, faces: Longs, attributes: dict[str, Doubles], material: Any) -> None:
        self.vertices, self.faces, self.attributes, self.material = vertices, faces, attributes, material

    def placed(self, transform: Doubles) -> "_Primitive":
        """Returns a copy transformed by [4,4]. A mirroring transform also reverses the winding."""
        linear = transform[:3, :3]
        mirrored = np.linalg.det(linear) < 0
        attributes = dict(self.attributes)
        if "NORMAL" in attributes:
            # The cofactor matrix is det · inverse transpose; it exists for singular transforms too.
            columns = linear.T
            cofactors = np.stack([np.cross(columns[(k + 1) % 3], columns[(k + 2) % 3]) for k in range(3)], axis=1)
            attributes["NORMAL"] = attributes["NORMAL"] @ cofactors.T * (-1.0 if mirrored else 1.0)
        if "TANGENT" in attributes:
            tangents = attributes["TANGENT"] * ((1, 1, 1, -1) if mirrored else (1, 1, 1, 1))
            tangents[:, :3] = attributes["TANGENT"][:, :3] @ linear.T
            attributes["TANGENT"] = tangents
        faces = self.faces[:, [0, 2, 1]] if mirrored else self.faces
        return _Primitive(self.vertices @ linear.T + transform[:3, 3], faces, attributes, self.material)

    def textured(self, coordinates: Sequence[_Coordinates]) -> "_Primitive":
        """Returns a copy with these texture coordinates in place of its own."""
        attributes = {name: values for name, values in self.attributes.items() if not name.startswith("TEXCOORD_")}
        for k, (uv_set, moved) in enumerate(coordinates):
            if f"TEXCOORD_{uv_set}" in self.attributes:
                linear = np.reshape(moved, (2, 3))
                attributes[f"TEXCOORD_{k}"] = self.attributes[f"TEXCOORD_{uv_set}"] @ linear[:, :2].T + linear[:, 2]
        return _Primitive(self.vertices, self.faces, attributes, self.material)

    def taken(self, index: Longs, faces: Longs) -> "_Primitive":
        """Returns the vertices `index`, in this order, with the given faces."""
        attributes = {name: values[index] for name, values in self.attributes.items()}
        return _Primitive(self.vertices[index], faces, attributes, self.material)


def _placed_nodes(file: GltfFile) -> Iterator[PlacedNode]:
    """Yields the nodes of the scene in depth-first order."""
    scenes = file.array("scenes")
    if scenes:
        chosen = file.tree.get("scene", 0)
        roots = elements(file.item("scenes", chosen), "nodes", f"scenes[{chosen}]")
    else:
        children = {child for node in file.array("nodes") for child in node.get("children", [])}
        roots = [index for index in range(len(file.array("nodes"))) if index not in children]
    waiting: list[tuple[Any, int | None, Doubles]] = [(index, None, np.eye(4)) for index in reversed(roots)]
    seen: set[int] = set()
    while waiting:
        index, parent, above = waiting.pop()
        node = file.item("nodes", index)
        if index in seen:
            raise Unreadable("its nodes are not a tree")
        transform = above @ _transform(node, f"nodes[{index}]")
        if "mesh" in node:
            file.item("meshes", node["mesh"])
        yield PlacedNode(index, node, parent, transform)
        waiting += [(child, len(seen), transform) for child in reversed(node.get("children", []))]
        seen.add(index)


def _transform(node: dict[str, Any], where: str) -> Doubles:
    """Returns a node's local matrix [4,4]: the stated matrix, or translation · rotation · scale."""
    limit = MAX_COORDINATE
    if "matrix" in node:
        return numbers(node, "matrix", tuple(np.eye(4).ravel()), -limit, limit, where).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0), -1.001, 1.001, where)
    length = x * x + y * y + z * z + w * w
    if length < 0.1:
        raise Unreadable(f"{where}.rotation is not a unit quaternion")
    s = 2 / length
    rotation = np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )
    matrix[:3, :3] = rotation * numbers(node, "scale", (1.0, 1.0, 1.0), -limit, limit, where)
    matrix[:3, 3] = numbers(node, "translation", (0.0, 0.0, 0.0), -limit, limit, where)
    return matrix


def _primitive(file: GltfFile, where: str, entry: dict[str, Any], accessors: dict[str, Any]) -> _Primitive | None:
    """Reads a primitive, with only the vertices that its triangles use; returns None if it has no triangles."""
    vertices = file.values(accessors["POSITION"], (3,))
    columns = {"NORMAL": (3,), "TANGENT": (4,), "TEXCOORD_0": (2,), "TEXCOORD_1": (2,), "COLOR_0": (3, 4)}
    attributes = {name: file.values(accessors[name], width) for name, width in columns.items() if name in accessors}
    for name, values in attributes.items():
        if not np.isfinite(values).all():
            raise Unreadable(f"{where}.attributes.{name} has values that are not finite numbers")
        if np.abs(values).max(initial=0) > MAX_COORDINATE:
            raise Unreadable(f"{where}.attributes.{name} has values beyond {MAX_COORDINATE:g}")
    corners = file.indices(entry["indices"]) if "indices" in entry else np.arange(len(vertices))
    if len(corners) and corners.max() >= len(vertices):
        raise Unreadable(f"{where}: a face names a vertex that is not there")
    mode = entry.get("mode", TRIANGLES)
    if mode == TRIANGLES:
        if len(corners) % 3:
            raise Unreadable(f"{where} has {len(corners):,} corners, which are no whole number of triangles")
        faces = corners.reshape(-1, 3)
    elif mode == STRIP:
        faces = (
            np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1) if len(corners) > 2 else np.zeros((0, 3), int)
        )
        faces[1::2] = faces[1::2, [1, 0, 2]]
    else:
        faces = np.stack([np.full(max(len(corners) - 2, 0), corners[0]), corners[1:-1], corners[2:]], axis=1)
    if not len(faces):
        return None
    used, local = np.unique(faces, return_inverse=True)
    if not np.isfinite(vertices[used]).all():
        raise Unreadable(f"{where} has vertices that are not finite numbers")
    if np.abs(vertices[used]).max() > MAX_COORDINATE:
        raise Unreadable(f"{where} has coordinates beyond {MAX_COORDINATE:g}")
    if "material" in entry:
        file.item("materials", entry["material"])
    whole = _Primitive(vertices, faces, attributes, entry.get("material"))
    return whole.taken(used, local.reshape(-1, 3))


def _fitted(
    nodes: list[PlacedNode],
    primitives: list[_Primitive],
    owners: list[int],
    materials: list[Material],
    note: Callable[[str], None],
) -> Placement:
    """Returns the parts without degenerate triangles, fitted to the frame. Raises Unreadable if no triangle is left."""
    points = np.concatenate([primitive.vertices for primitive in primitives])
    if not np.isfinite(points).all() or np.abs(points).max() > MAX_COORDINATE:
        raise Unreadable(f"its nodes put vertices beyond {MAX_COORDINATE:g}")
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    if extent < 1 / MAX_COORDINATE:
        raise Unreadable("all its vertices are at one point: it has no area")
    # Files use any unit; in the file's own unit areas could overflow or underflow.
    middle = points.mean(axis=0)
    parts = []
    shown = 0
    for owner, primitive, material in zip(owners, primitives, materials, strict=True):
        primitive.vertices = (primitive.vertices - middle) / extent
        corners = primitive.vertices[primitive.faces]
        edges = corners - np.roll(corners, 1, axis=1)
        across = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        proper = across > _MIN_HEIGHT * (edges**2).sum(axis=2).max(axis=1)
        shown += int(proper.sum())
        if proper.any():
            used, local = np.unique(primitive.faces[proper], return_inverse=True)
            parts.append((owner, _part(primitive.taken(used, local.reshape(-1, 3)), material)))
    if not parts:
        raise Unreadable("none of its triangles has an area")
    if sentence := rounding_note(points, sum(len(primitive.faces) for primitive in primitives), shown):
        note(sentence)
    parts.sort(key=lambda owned: _blends(owned[1]))
    whole = tuple(part for _, part in parts)
    low, high, radius = ball(whole)
    centre = (low + high) / 2 * extent + middle
    return Placement(nodes, [owner for owner, _ in parts], fitted(whole), centre, radius * extent)


def _check_texels(materials: list[Material]) -> None:
    size = sum(texture.texels.nbytes for material in materials for texture in material.maps.values())
    if size > MAX_TEXELS:
        raise Unreadable(
            f"the textures of its parts take {size:,} bytes, each counted where it is used; at most "
            f"{MAX_TEXELS:,} are taken"
        )


def _blends(part: Part) -> bool:
    return part.metallic_roughness is not None and part.metallic_roughness.alpha_mode == "BLEND"


def _part(primitive: _Primitive, material: Material) -> Part:
    attributes = primitive.attributes
    flat = "NORMAL" not in attributes
    if flat:  # give each triangle its own vertices
        primitive = primitive.taken(primitive.faces.ravel(), np.arange(primitive.faces.size).reshape(-1, 3))
    normals = _normals(primitive)
    for name, texture in material.maps.items():
        uv_set = material.coordinates[texture.uv_set].uv_set
        if f"TEXCOORD_{uv_set}" not in attributes:
            raise Unreadable(f"the {name.replace('_', ' ')} texture wants TEXCOORD_{uv_set}, which is not there")
    if material.coordinates != _AS_STORED:
        primitive = primitive.textured(material.coordinates)
    tangents = np.zeros((len(normals), 4))
    if "normal" in material.maps:
        if "TANGENT" in attributes and not flat:
            tangents = primitive.attributes["TANGENT"]
            tangents[:, :3] /= np.maximum(np.linalg.norm(tangents[:, :3], axis=1, keepdims=True), 1e-30)
        else:
            uv = _upwards(primitive.attributes[f"TEXCOORD_{material.maps['normal'].uv_set}"])
            split = derive_tangents(primitive.vertices, normals, uv, primitive.faces)
            primitive, normals = primitive.taken(split.source, split.faces), normals[split.source]
            tangents = split.tangents
    count = len(normals)
    attributes = primitive.attributes
    colors = np.ones((count, 4))
    if "COLOR_0" in attributes:
        colors[:, : attributes["COLOR_0"].shape[1]] = np.clip(attributes["COLOR_0"], 0, 1)
    uv_sets = [_upwards(attributes.get(f"TEXCOORD_{k}", np.zeros((count, 2)))).astype(np.float32) for k in (0, 1)]
    settings = {field.name: getattr(material, field.name) for field in fields(MaterialSettings)}
    return Part(
        vertices=primitive.vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        faces=primitive.faces.astype(np.int32),
        uv=uv_sets[0],
        color=material.color,
        metallic_roughness=MetallicRoughness(
            **settings,
            tangents=tangents.astype(np.float32),
            second_uv=uv_sets[1],
            vertex_colors=colors.astype(np.float32),
        ),
    )


def _normals(primitive: _Primitive) -> Doubles:
    """Returns unit normals [V,3]: the file's, or a face's where the file has none or a zero vector."""
    corners = primitive.vertices[primitive.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.empty_like(primitive.vertices)
    normals[primitive.faces.ravel()] = np.repeat(across / np.linalg.norm(across, axis=1, keepdims=True), 3, axis=0)
    if "NORMAL" in primitive.attributes:
        stated = primitive.attributes["NORMAL"]
        lengths = np.linalg.norm(stated, axis=1, keepdims=True)
        normals = np.where(lengths > 1e-12, stated / np.maximum(lengths, 1e-30), normals)
    return normals


def _upwards(uv: Doubles) -> Doubles:
    """Converts glTF's texture coordinates (v downwards) to OpenGL's (v upwards)."""
    return np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)
