"""Reads a glTF file as the parts of a mesh: every triangle of its scene, transformed, with its material.

Vertices are not smoothed or welded and faces are not flipped: glTF states normals, winding and tangents, and
defines the defaults where they are left out (flat normals; tangents along the texture). Materials are
metallic-roughness. Khronos, glTF 2.0 specification, 3.5 to 3.9.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from math import inf
from typing import Any

import numpy as np

from services.scenes.gltf_file import STRIP, TRIANGLES, GltfFile, MissingFile, elements, number, numbers
from services.scenes.image_file import FORMATS
from services.scenes.mesh import (
    AlphaMode,
    Doubles,
    Floats,
    Longs,
    MapName,
    MaterialSettings,
    MetallicRoughness,
    Part,
    TextureMap,
    fitted,
)
from services.scenes.normals import derive_tangents
from services.scenes.surfaces import MAX_COORDINATE, Textures, rounding_note
from services.scenes.unreadable import TooLarge, Unreadable

_WRAPS = (10497, 33071, 33648)
_MODES: tuple[AlphaMode, ...] = ("OPAQUE", "MASK", "BLEND")


@dataclass(frozen=True, eq=False)
class Material(MaterialSettings):
    """A material of a glTF file, with glTF's defaults. color: float32 [4], the base colour factor, linear RGBA."""

    color: Floats


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
                maps[name] = _map(file, owner[key], textures, f"{inner if owner is surface else where}.{key}")
    return Material(
        color=color,
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


def _map(file: GltfFile, info: Any, textures: Textures, where: str) -> TextureMap:
    if not isinstance(info, dict):
        raise Unreadable(f"{where} is not an object")
    uv_set = info.get("texCoord", 0)
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
    return TextureMap(texels, uv_set, wrap)


MAX_PARTS = 2_000
"""Largest number of primitives in the scene; each is a part, which is drawn by itself."""
MAX_TEXELS = 2**29
"""Bytes of all maps of all parts. A processed mesh on the disk holds a map once for each part that has it."""
_MIN_HEIGHT = 1e-6
"""Ratio of a triangle's height to its longest edge below which a normal from float32 coordinates is noise."""


def read_gltf(file: GltfFile, max_faces: int, note: Callable[[str], None] = lambda _: None) -> tuple[Part, ...]:
    """Returns the parts of a file's scene, fitted to the frame; alpha-blended parts come last. `note` is given what
    is not shown.

    Raises Unreadable, which names the element of the file, for invalid elements (`GltfFile`, `read_material`), for
    vertices that are not finite or beyond MAX_COORDINATE, and for no triangle with an area; TooLarge for more than
    `max_faces` triangles.
    """
    placed = list(_instances(file))
    primitives: dict[int, list[_Primitive]] = {}
    textures = Textures()
    materials: dict[Any, Material] = {}
    count = 0
    for index, _ in placed:
        if index not in primitives:
            read = (_primitive(file, *entry) for entry in file.primitives(index))
            primitives[index] = [primitive for primitive in read if primitive is not None]
        count += sum(len(primitive.faces) for primitive in primitives[index])
    if count > max_faces:
        raise TooLarge(count, "triangles", max_faces)
    parts = []
    if (total := sum(len(primitives[index]) for index, _ in placed)) > MAX_PARTS:
        raise Unreadable(f"its scene has {total:,} primitives; at most {MAX_PARTS:,} are taken")
    for index, transform in placed:
        for primitive in primitives[index]:
            key = primitive.material
            if key not in materials:
                materials[key] = read_material(file, key, textures)
            parts.append(primitive.placed(transform))
    if not parts:
        raise Unreadable("it has no triangles")
    _check_texels([materials[primitive.material] for primitive in parts])
    return _parts(parts, [materials[primitive.material] for primitive in parts], note)


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

    def taken(self, index: Longs, faces: Longs) -> "_Primitive":
        """Returns the vertices `index`, in this order, with the given faces."""
        attributes = {name: values[index] for name, values in self.attributes.items()}
        return _Primitive(self.vertices[index], faces, attributes, self.material)


def _instances(file: GltfFile) -> Iterator[tuple[int, Doubles]]:
    """Yields the index and the transform [4,4] of each mesh in the scene, in depth-first order of its nodes."""
    scenes = file.array("scenes")
    if scenes:
        chosen = file.tree.get("scene", 0)
        roots = elements(file.item("scenes", chosen), "nodes", f"scenes[{chosen}]")
    else:
        children = {child for node in file.array("nodes") for child in node.get("children", [])}
        roots = [index for index in range(len(file.array("nodes"))) if index not in children]
    waiting = [(index, np.eye(4)) for index in reversed(roots)]
    seen: set[int] = set()
    while waiting:
        index, parent = waiting.pop()
        node = file.item("nodes", index)
        if index in seen:
            raise Unreadable("its nodes are not a tree")
        seen.add(index)
        transform = parent @ _transform(node, f"nodes[{index}]")
        if "mesh" in node:
            file.item("meshes", node["mesh"])
            yield node["mesh"], transform
        waiting += [(child, transform) for child in reversed(node.get("children", []))]


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
        if len(values) != len(vertices):
            raise Unreadable(f"{where} has {len(values):,} of {name} for {len(vertices):,} vertices")
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


def _parts(primitives: list[_Primitive], materials: list[Material], note: Callable[[str], None]) -> tuple[Part, ...]:
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
    for primitive, material in zip(primitives, materials, strict=True):
        primitive.vertices = (primitive.vertices - middle) / extent
        corners = primitive.vertices[primitive.faces]
        edges = corners - np.roll(corners, 1, axis=1)
        across = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        proper = across > _MIN_HEIGHT * (edges**2).sum(axis=2).max(axis=1)
        shown += int(proper.sum())
        if proper.any():
            used, local = np.unique(primitive.faces[proper], return_inverse=True)
            parts.append(_part(primitive.taken(used, local.reshape(-1, 3)), material))
    if not parts:
        raise Unreadable("none of its triangles has an area")
    if sentence := rounding_note(points, sum(len(primitive.faces) for primitive in primitives), shown):
        note(sentence)
    return fitted(tuple(sorted(parts, key=_blends)))


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
        if f"TEXCOORD_{texture.uv_set}" not in attributes:
            raise Unreadable(
                f"the {name.replace('_', ' ')} texture wants TEXCOORD_{texture.uv_set}, which is not there"
            )
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
        texture=None,
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
