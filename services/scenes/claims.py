"""Checks a mesh file before a parser reads it: what would take too much time or memory is refused, and so is what a
parser would pass over without a word. What a parser refuses itself is left to it.
"""

import re
import struct
from collections.abc import Callable

from services.errors import InvalidRequest
from services.scenes.beside import check_xml
from services.scenes.bundle import SIGNATURE, unpack_archive
from services.scenes.gltf_file import GltfFile, elements, json_of, size
from services.scenes.unreadable import TooLarge, Unreadable

_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}
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
    _check_triangle_count(face_lines, max_faces)
    faces = re.findall(rb"^[ \t]*f\b([^\r\n]*)", data, re.MULTILINE)
    _check_triangle_count(sum(len(face.split()) - 2 for face in faces), max_faces)
    _check_vertex_count(vertex_lines, max_faces)
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
    _check_triangle_count(counts.get("face", 0), max_faces)
    _check_vertex_count(counts.get("vertex", 0), max_faces)
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
            _check_triangle_count(count, max_faces)
            return
    text = data[:4096].lstrip().lower()
    if not text.startswith(b"solid") or b"\0" in data:
        raise Unreadable("it is neither text that begins with `solid` nor as long as its triangle count says")
    vertices = len(re.findall(rb"\bvertex\b", data, re.IGNORECASE))
    _check_triangle_count(vertices // 3, max_faces)
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
    _check_triangle_count(faces, max_faces)
    _check_vertex_count(vertices, max_faces)
    _check_numbers(b" ".join(rest))
    if len(rest) - 1 < vertices + faces:
        raise Unreadable(f"it declares {vertices:,} vertices and {faces:,} faces, but {len(rest) - 1:,} lines follow")


def _glb(data: bytes, _: int) -> None:
    if data[:4] != b"glTF":
        raise Unreadable("it does not begin with glTF")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise Unreadable(f"it is a file of glTF {version}; files of glTF 2 are read")
    if length != len(data):
        raise Unreadable(f"its header says that it has {length:,} bytes, but it has {len(data):,}; is it complete?")


def _gltf(data: bytes, _: int) -> None:
    text = data.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not text.startswith(b"{"):
        raise Unreadable("it does not begin with an object of JSON")
    asset = json_of(text).get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if not str(version).startswith("2"):
        raise Unreadable(f"it is a file of glTF {version!r}; files of glTF 2 are read")


def _dae(data: bytes, max_faces: int) -> None:
    check_xml(data)
    if not re.match(rb"[\xef\xbb\xbf\s]*<(?:\?xml|COLLADA|!--)", data) or b"<COLLADA" not in data:
        raise Unreadable("it is no COLLADA file")
    for array in re.finditer(rb"<float_array\b[^>]*>([^<]*)", data):
        if re.search(rb"nan|inf", array[1], re.IGNORECASE):  # the parser would make 0 of them
            raise Unreadable("it has numbers that are not finite")
    counts = re.findall(_COUNT, data)
    _check_triangle_count(sum(map(int, counts)), max_faces)


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
    _check_triangle_count(sum(model.count(b"<triangle ") for model in models), max_faces)
    _check_vertex_count(sum(model.count(b"<vertex ") for model in models), max_faces)


def check_elements(file: GltfFile, held: int, max_faces: int) -> None:
    """Counts what a glTF file declares. `held` is the number of bytes of the file and those beside it.

    Raises Unreadable, which names the element, for more than the limits, and for nodes that are no tree.
    """
    for name, most in _MAX_ELEMENTS.items():
        if len(file.array(name)) > most:
            raise Unreadable(f"it has {len(file.array(name)):,} {name}; at most {most:,} are taken")
    if any("bufferView" not in accessor for accessor in file.items("accessors")):
        raise Unreadable("it has accessors without data (compressed geometry is not read)")
    views = enumerate(file.items("bufferViews"))
    if sum(size(view.get("byteLength"), f"bufferViews[{k}].byteLength") for k, view in views) > 4 * held:
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
    _check_triangle_count(corners // 3, max_faces)
    # Primitives may share an accessor of vertices, but the parser copies it for each.
    _check_vertex_count(vertices // 8, max_faces)


def _check_numbers(text: bytes) -> None:
    # Parsers stop at the first word that is not a number and continue with the numbers read so far.
    strange = text.translate(None, b"0123456789+-.eE \t\r\nnaifNAIF")
    if strange:
        raise Unreadable(f"it has {strange[:20].decode('latin-1')!r} where there should be numbers")


def _check_triangle_count(triangles: int, max_faces: int) -> None:
    if triangles > max_faces:
        raise TooLarge(triangles, "triangles", max_faces)


def _check_vertex_count(vertices: int, max_faces: int) -> None:
    # A triangle has three vertices, so more than three per triangle are unused.
    if vertices > 3 * max_faces:
        raise TooLarge(vertices, "vertices", 3 * max_faces)


CHECKS: dict[str, Callable[[bytes, int], None]] = {
    "obj": _obj,
    "ply": _ply,
    "stl": _stl,
    "glb": _glb,
    "off": _off,
    "gltf": _gltf,
    "dae": _dae,
    "3mf": _3mf,
}
"""Validators by file kind. Each takes the bytes and the largest number of triangles, and raises TooLarge for more, and
Unreadable (or another exception of its parsing) if the file cannot be valid."""
