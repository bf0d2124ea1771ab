"""Reads mesh files that are not trusted: upright, as parts, with a report of what of them is shown and what is not.

A file is checked before a parser reads it: what would take too much time or memory is refused, and so is what a parser
would pass over without a word. What a parser refuses itself is left to it.
"""

import re
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from scene_attack.errors import DAMAGED, InvalidRequest, Unreadable, shortened
from scene_attack.extras import extra
from scene_attack.scenes.bundle import SIGNATURE, Up, unpack_archive
from scene_attack.scenes.image_file import open_texture
from scene_attack.scenes.mesh import Part, TooLarge, check_size
from scene_attack.scenes.reading.companion_files import CompanionFiles, check_xml, decoded, texture_name
from scene_attack.scenes.reading.gltf import LIGHTS, READ_EXTENSIONS, GltfFile, check_glb, check_gltf, read_gltf
from scene_attack.scenes.reading.gltf_scene import read_scene
from scene_attack.scenes.reading.isolated import Report, listed
from scene_attack.scenes.reading.surfaces import MAX_TEXTURE, read_opacity, read_surfaces, to_parts
from scene_attack.scenes.scene_file import SceneFile

_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}
_MAX_PIECES = 2_000
"""Largest number of materials of an obj file, or of solids of an stl file: a factor of the parser's time."""
MAX_3MF = 2**27
"""Bytes of all files in a 3mf file, unpacked."""
_COUNT = rb"<(?:triangles|polylist|polygons|trifans|tristrips)\b[^>]*?\bcount\s*=\s*[\"'](\d{1,18})"
"""Pattern of a COLLADA element's stated number of triangles or polygons."""
_MAX_BLANK_LINES = 1_000
"""Lines at the end of a ply file in text, beyond those that its header declares."""


def _obj(data: bytes, max_faces: int) -> None:
    # Lines are counted before they are kept, which takes 20 times the memory of a short line.
    vertex_lines, face_lines = (_count_lines(data, key) for key in (rb"v[ \t]", rb"f\b"))
    if not vertex_lines or not face_lines:
        raise Unreadable("it has no vertices (`v x y z`) or no faces (`f a b c`)")
    check_size(max_faces, face_lines)
    faces = re.findall(rb"^[ \t]*f\b([^\r\n]*)", data, re.MULTILINE)
    check_size(max_faces, sum(len(face.split()) - 2 for face in faces), vertex_lines)
    materials = len(set(re.findall(rb"^[ \t]*usemtl\b([^\r\n]*)", data, re.MULTILINE)))
    if materials > _MAX_PIECES:
        raise Unreadable(f"it has {materials:,} materials; at most {_MAX_PIECES:,} are taken")
    number = rb"[ \t]+-?\d+(?:/-?\d*){0,2}"
    for face in faces:
        # A backslash continues the line; the continuation is left to the parser.
        if not re.fullmatch(rb"(?:" + number + rb"){3,}[ \t]*\\?", face):
            raise Unreadable(f"the face `f{face[:60].decode('latin-1')}` has no three vertex numbers")
    vertices = re.findall(rb"^[ \t]*v[ \t]+([^\r\n]*)", data, re.MULTILINE)
    _check_numbers(b" ".join(vertices))


def _count_lines(data: bytes, key: bytes) -> int:
    return sum(1 for _ in re.finditer(rb"^[ \t]*" + key, data, re.MULTILINE))


def _ply(data: bytes, max_faces: int) -> None:
    header, end, body = data.partition(b"end_header")
    if not re.match(rb"ply\r?\n", data) or not end or len(header) > 100_000:
        raise Unreadable("it does not begin with a PLY header")
    lines = [line.split() for line in header.decode("ascii", "replace").splitlines()]
    ascii_body = ["format", "ascii", "1.0"] in lines
    counts: dict[str, int] = {}
    needed, row = 0, 0
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3:
            name, row = words[1], int(words[2])
            if row < 0 or name in counts:
                raise Unreadable("its header declares an element twice, or a negative number of them")
            counts[name] = row
        elif words[:1] == ["property"] and len(words) in (3, 5):
            # A list may be empty, so at least its count is needed.
            size_of_value = _SIZES[words[2] if words[1] == "list" else words[1]]
            # In a text file a value takes at least a digit and a blank.
            needed += row * (2 if ascii_body else size_of_value)
    check_size(max_faces, counts.get("face", 0), counts.get("vertex", 0))
    if needed > len(body) + 1:
        raise Unreadable(f"its header declares at least {needed:,} bytes of elements, but {len(body):,} follow")
    if ascii_body:
        lines_more = body.count(b"\n") - 1 - sum(counts.values())  # the first ends the header
        if lines_more > _MAX_BLANK_LINES:
            raise Unreadable(f"it has {lines_more:,} lines more than its header declares")
        _check_numbers(body)


def _stl(data: bytes, max_faces: int) -> None:
    if len(data) >= 84:
        (count,) = struct.unpack_from("<I", data, 80)
        if len(data) == 84 + 50 * count:
            check_size(max_faces, count)
            return
    text = data[:4096].lstrip().lower()
    if not text.startswith(b"solid") or b"\0" in data:
        raise Unreadable("it is neither text that begins with `solid` nor as long as its triangle count says")
    vertices = len(re.findall(rb"\bvertex\b", data, re.IGNORECASE))
    check_size(max_faces, vertices // 3)
    complete = len(re.findall(rb"\bvertex(?:[ \t]+[-+.\dA-Za-z]+){3}[ \t]*\r?$", data, re.IGNORECASE | re.MULTILINE))
    solids = len(re.findall(rb"endsolid", data, re.IGNORECASE))
    if vertices % 3 or complete != vertices or not solids:  # the parser passes over a last solid that is cut off
        raise Unreadable("its triangles are incomplete")
    if solids > _MAX_PIECES:
        raise Unreadable(f"it has {solids:,} solids; at most {_MAX_PIECES:,} are taken")


def _off(data: bytes, max_faces: int) -> None:
    lines = [line for line in (raw.partition(b"#")[0].strip() for raw in data.splitlines()) if line]
    match = re.match(rb"C?OFF\b(.*)", lines[0]) if lines else None
    if match is None:
        raise Unreadable("it does not begin with OFF or COFF")
    rest = [match[1].strip(), *lines[1:]] if match[1].strip() else lines[1:]
    counts = rest[0].split() if rest else []
    if len(counts) < 2:
        raise Unreadable("it does not say how many vertices and faces it has")
    vertices, faces = int(counts[0]), int(counts[1])
    check_size(max_faces, faces, vertices)
    _check_numbers(b" ".join(rest))
    if len(rest) - 1 < vertices + faces:
        raise Unreadable(f"it declares {vertices:,} vertices and {faces:,} faces, but {len(rest) - 1:,} lines follow")


def _dae(data: bytes, max_faces: int) -> None:
    check_xml(data)
    if not re.match(rb"[\xef\xbb\xbf\s]*<(?:\?xml|COLLADA|!--)", data) or b"<COLLADA" not in data:
        raise Unreadable("it is no COLLADA file")
    for array in re.finditer(rb"<float_array\b[^>]*>([^<]*)", data):
        if re.search(rb"nan|inf", array[1], re.IGNORECASE):  # the parser would make 0 of them
            raise Unreadable("it has numbers that are not finite")
    counts = re.findall(_COUNT, data)
    check_size(max_faces, sum(map(int, counts)))


def _3mf(data: bytes, max_faces: int) -> None:
    if not data.startswith(SIGNATURE):
        raise Unreadable("it is no zip file")
    try:
        files = unpack_archive(data, MAX_3MF)
    except InvalidRequest as error:
        raise Unreadable(error.detail) from error
    models = [model for name, model in files.items() if name.lower().endswith(".model")]
    if not models:
        raise Unreadable("there is no 3D model in it")
    for model in models:
        check_xml(model)
    text = b"".join(models)
    check_size(max_faces, text.count(b"<triangle "), text.count(b"<vertex "))


def _check_numbers(text: bytes) -> None:
    # Parsers stop at the first word that is not a number and continue with the numbers read so far.
    strange = text.translate(None, b"0123456789+-.eE \t\r\nnaifNAIF")
    if strange:
        raise Unreadable(f"it has {strange[:20].decode('latin-1')!r} where there should be numbers")


CHECKS: dict[str, Callable[[bytes, int], None]] = {
    "obj": _obj,
    "ply": _ply,
    "stl": _stl,
    "glb": check_glb,
    "off": _off,
    "gltf": check_gltf,
    "dae": _dae,
    "3mf": _3mf,
}
"""Validators by file kind. Each takes the bytes and the largest number of triangles, and raises TooLarge for more, and
Unreadable (or another exception of its parsing) if the file cannot be valid."""


def is_z_up(data: bytes, kind: str) -> bool:
    """Whether +z is up: in every 3mf file, and in a dae file that says so. In all other formats +y is."""
    return kind == "3mf" or (kind == "dae" and re.search(rb"<up_axis>\s*Z_UP\s*<", data) is not None)


def upright(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """Returns the parts of a file in which +z is up with +y up: turned about x by −90°, which leaves them fitted."""
    turned_parts = []
    for part in parts:
        own = part.metallic_roughness
        turned = replace(part, vertices=_turned(part.vertices), normals=_turned(part.normals))
        if own is not None:
            tangents = np.concatenate([_turned(own.tangents[:, :3]), own.tangents[:, 3:]], axis=1)
            turned = replace(turned, metallic_roughness=replace(own, tangents=tangents))
        turned_parts.append(turned)
    return tuple(turned_parts)


def _turned(vectors: NDArray[Any]) -> NDArray[Any]:
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)


KINDS = tuple(CHECKS)
"""The file kinds that are read."""


_TURNED = "it was added with +z up; in the scene of a glTF file +y is up"


def read_mesh(
    data: bytes,
    kind: str,
    max_faces: int,
    beside: CompanionFiles | None = None,
    up: Up | None = None,
    note: Callable[[str], None] = lambda _: None,
    tell: Callable[[SceneFile], None] = lambda _: None,
) -> tuple[Part, ...]:
    """Returns the parts of a mesh file, fitted to the frame. `kind` is an element of KINDS; `beside` has the materials
    and textures that it may name. `up` is the file's axis that points up; None: as its format says.
    `note` is given what its coordinates have lost (`rounding_note`), `tell` the scene of a format that has one.

    Raises InvalidRequest("kind", …) for an unknown kind, and InvalidRequest("file", …) if the bytes are not of that
    kind, declare more data than they hold, cannot be parsed, have no triangles or more than `max_faces`, have vertices
    that are not finite, or have no area, or if a texture is no image.
    """
    turned = up == "z" and kind in ("glb", "gltf")
    told = (lambda _: tell(SceneFile(unusable=_TURNED))) if turned else tell
    parts = _parts(data, kind, max_faces, beside or CompanionFiles({}), note, told)
    return upright(parts) if up == "z" or (up is None and is_z_up(data, kind)) else parts


def check_packages(kind: str) -> None:
    """Raises MissingExtra("file") if the packages are not installed that read this kind."""
    with extra("formats", f"a {kind} mesh", "file"):
        if kind in ("dae", "3mf"):
            import networkx  # noqa: F401
        if kind == "dae":
            import collada  # noqa: F401


def _parts(
    data: bytes,
    kind: str,
    max_faces: int,
    beside: CompanionFiles,
    note: Callable[[str], None],
    tell: Callable[[SceneFile], None],
) -> tuple[Part, ...]:
    if kind not in CHECKS:
        raise InvalidRequest("kind", f"{kind!r} meshes are not read; one of {', '.join(KINDS)} is")
    if not data.strip():
        raise InvalidRequest("file", "it is empty")
    check_packages(kind)
    try:
        CHECKS[kind](data, max_faces)
        # Suppress numpy's warnings: numbers that are not finite are reported by name.
        with np.errstate(all="ignore"):
            if kind in ("glb", "gltf"):
                file = GltfFile(data.removeprefix(b"\xef\xbb\xbf"), beside)
                return read_gltf(file, max_faces, note, lambda placement: tell(read_scene(file, placement)))
            beside.check()
            text = decoded(data).encode() if kind in ("obj", "off") else _in_doubles(data) if kind == "ply" else data
            scene = trimesh.load_scene(BytesIO(text), file_type=kind, resolver=beside, process=False)
            check_size(max_faces, triangles(scene))
    except (MemoryError, InvalidRequest):
        raise
    except TooLarge as error:
        raise InvalidRequest("file", str(error)) from error
    except Exception as error:  # parsers raise many types of exceptions; in every case the file is invalid
        message = shortened(error) if isinstance(error, Unreadable) else DAMAGED
        raise InvalidRequest("file", f"it is not a readable {kind} mesh: {message}") from error
    try:
        # Nobody sends what cannot be seen: an opacity of 0 is a writer's mistake, of `Tr` above all.
        opacity = {name: value or 1.0 for name, value in read_opacity(beside.libraries()).items()}
        return to_parts(read_surfaces(scene, opacity), note=note)
    except (ValueError, OSError, SyntaxError) as error:  # a damaged texture is an OSError or a SyntaxError of Pillow
        is_ours = isinstance(error, Unreadable)
        message = shortened(error) if is_ours else "a texture or its coordinates are damaged, or cut off"
        raise InvalidRequest("file", f"it cannot be shown: {message}") from error


def _in_doubles(ply: bytes) -> bytes:
    """Declares the coordinates of a PLY file in text as 64-bit numbers: its digits may be more than 32 bits hold."""
    header, end, body = ply.partition(b"end_header")
    if not re.search(rb"(?m)^format ascii\b", header):
        return ply
    return (
        re.sub(rb"(?m)^property[ \t]+float(?:32)?[ \t]+([xyz])[ \t]*(?=\r?$)", rb"property double \1", header)
        + end
        + body
    )


def triangles(scene: trimesh.Scene) -> int:
    """Returns the number of triangles of a scene over all instances, without creating the instances."""
    counts = {name: len(getattr(geometry, "faces", ())) for name, geometry in scene.geometry.items()}
    return sum(counts[scene.graph[node][1]] for node in scene.graph.nodes_geometry)


_3MF = {b"<basematerials": "materials", b":colorgroup": "colours", b":texture2d": "textures"}
"""Elements of a model in a 3mf file that the parser passes over, with their names in a report."""
_SHOWN_BY_A_SCENE = ("cameras", "skins", "morph targets", f"extension {LIGHTS}")
"""What a mesh does not show of a glTF file, and a scene does, or says by the names of nodes."""
_NOT_DRAWN = {"animations": "animations", "skins": "skins", "cameras": "cameras"}


def report(
    data: bytes,
    kind: str,
    beside: CompanionFiles,
    parts: Sequence[Part],
    notes: Sequence[str],
    scene: SceneFile | None = None,
) -> Report:
    """Returns what became of what a mesh file holds and names.

    `parts` are those that were read from it, `notes` what was said of it then to be not shown, and `scene` its scene,
    which shows more of it.
    """
    used, dropped = _files(beside, any(part.textured for part in parts))
    dropped = [*notes, *dropped]
    if kind == "obj" and re.search(rb"(?m)^[ \t]*v(?:[ \t]+[-+.\deE]+){6}", data):
        hidden = beside.libraries() or re.search(rb"(?m)^[ \t]*f[ \t]+-?\d+/-?\d", data)
        (dropped if hidden else used).append("vertex colours")
    if kind == "off" and data.startswith(b"COFF"):
        dropped.append("vertex colours")
    if kind == "ply" and (red := re.search(rb"(?m)^property \w+ red\b", data[: data.find(b"end_header")])):
        colours = "face colours" if b"element face" in data[: red.start()] else "vertex colours"
        (dropped if any(entry.startswith("texture ") for entry in used) else used).append(colours)
    if kind in ("glb", "gltf"):
        more, less = _gltf_report(GltfFile(data.removeprefix(b"\xef\xbb\xbf"), beside), parts)
        used, dropped = used + more, dropped + less
    if kind == "dae" and b'semantic="COLOR"' in data:
        (dropped if b"<instance_material" in data else used).append("vertex colours")
    if "vertex colours" in used and kind not in ("glb", "gltf"):
        dropped.append("blends of vertex colours: each triangle has the mean of its corners")
    if any(_is_partly_opaque(part) for part in parts):
        dropped.append("partial opacity of colours: below a half is cut out, the rest is opaque")
    if kind == "3mf":
        models = b"".join(
            content for name, content in unpack_archive(data, MAX_3MF).items() if name.lower().endswith(".model")
        )
        dropped += [word for mark, word in _3MF.items() if mark in models]
    if scene is not None and scene.own is None:  # a description says all of its scene
        others = [phrase for phrase in dropped if phrase not in _SHOWN_BY_A_SCENE]
        scene = scene.model_copy(update={"left_out": listed([*scene.left_out, *others])})
    return Report(listed(used), listed(dropped), scene)


def _files(beside: CompanionFiles, textured: bool) -> tuple[list[str], list[str]]:
    used: list[str] = []
    dropped: list[str] = []
    named_paths: set[str | None] = set()
    for file in beside.named:
        path = beside.find(file.name)
        label = f"{file.what} {path or file.name}"
        named_paths.add(path)
        if path is None:
            dropped.append(f"{label} missing")
        elif not file.is_shown:
            dropped.append(f"{label} not used")
        elif file.what == "texture" and not textured:
            dropped.append(f"{label} not used: the mesh has no texture coordinates")
        else:
            used.append(label)
            dropped += _detail(label, open_texture(beside.data(path), path)) if file.what == "texture" else []
    for options in re.findall(r"(?mi)^\s*map_Kd\s+(-\S.*)$", beside.libraries()):
        words, name = texture_name(options)
        dropped.append(f"options {words} of the texture {name}")
    dropped += [
        f"opacity 0 of the material {name}" for name, value in read_opacity(beside.libraries()).items() if not value
    ]
    dropped += [f"{path} not used: the mesh does not name it" for path in beside.paths if path not in named_paths]
    return used, dropped


def _is_partly_opaque(part: Part) -> bool:
    """Whether a surface that no glTF file describes has texels between opaque and transparent."""
    if part.texture is None:
        return False
    opacity = part.texture[..., 3]
    return bool(((opacity > 0) & (opacity < 255)).any())


def _detail(label: str, image: Image.Image) -> list[str]:
    """Returns a report on a texture that is shown with fewer texels than it has; an empty list for all others."""
    if max(image.size) <= MAX_TEXTURE:
        return []
    return [f"detail of {label}: {image.width}×{image.height} texels, of which at most {MAX_TEXTURE} a side are shown"]


def _gltf_report(file: GltfFile, parts: Sequence[Part]) -> tuple[list[str], list[str]]:
    materials = [part.metallic_roughness for part in parts if part.metallic_roughness is not None]
    names = dict.fromkeys(name for material in materials for name in material.maps)
    used = [f"{name.replace('_', ' ')} map" for name in names]
    if any((material.vertex_colors != 1).any() for material in materials):
        used.append("vertex colours")
    tree = file.tree
    dropped = [word for key, word in _NOT_DRAWN.items() if tree.get(key)]
    if any(primitive.get("targets") for mesh in tree.get("meshes", []) for primitive in mesh.get("primitives", [])):
        dropped.append("morph targets")
    for index in range(len(file.array("images"))):
        with suppress(ValueError):  # one that nothing shows, or the mesh would have been refused
            uri = file.item("images", index).get("uri", "data:")
            # `_files` knows those in files of their own.
            dropped += _detail(f"images[{index}]", file.image(index)) if str(uri).startswith("data:") else []
    dropped += [f"extension {name}" for name in file.array("extensionsUsed") if name not in READ_EXTENSIONS]
    return used, dropped
