"""The files beside a mesh file: which ones it names, and how its parser finds them, by those names and nothing else.

XML files that are not trusted are checked before they are parsed: entities are refused.
"""

import json
import posixpath
import re
import struct
from collections.abc import Mapping
from functools import cached_property
from io import BytesIO
from typing import Any, NamedTuple
from urllib.parse import unquote

from scene_attack.errors import DAMAGED, InvalidRequest, Unreadable
from scene_attack.extras import extra
from scene_attack.scenes.image_file import open_texture


class Named(NamedTuple):
    """A file that another names: its name, and what it is to it."""

    name: str
    what: str

    @property
    def is_shown(self) -> bool:
        """Whether meshes other than glTF are drawn with it: of the maps only the texture is."""
        return self.what in ("material library", "texture", "buffer")


def decoded(data: bytes) -> str:
    """Returns text that is UTF-8 or, if it cannot be, Latin-1: names may be in any encoding."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


_ENCODINGS = (b"utf-8", b"us-ascii", b"ascii", b"iso-8859-1", b"windows-1252")
_SLOTS = {
    "diffuse": "texture",
    "emission": "emission map",
    "ambient": "ambient map",
    "specular": "specular map",
    "reflective": "reflection map",
    "transparent": "opacity map",
    "bump": "bump map",
    "normal": "normal map",
}
"""Role of an image by the slot of a COLLADA effect that has it. Only the first role, the texture, is shown."""


def check_xml(data: bytes) -> None:
    """Raises Unreadable for a document type, which is where entities are declared, or an unusual encoding.

    Entities can name files and addresses, and a few of them stand for gigabytes; another encoding would hide them.
    """
    if b"\0" in data or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise Unreadable("its text is not UTF-8")
    declared = re.match(rb"[\xef\xbb\xbf\s]*<\?xml[^>]*?encoding\s*=\s*[\"']([^\"']*)", data)
    if declared and declared[1].lower() not in _ENCODINGS:
        raise Unreadable(f"its encoding is {declared[1][:40].decode('latin-1')!r}; UTF-8 is read")
    if re.search(rb"<!\s*(?:DOCTYPE|ENTITY)", data, re.IGNORECASE):
        raise Unreadable("it declares a document type or entities, which are not read")


def collada_images(data: bytes) -> list[Named]:
    """Returns the image files that a COLLADA file names: those that effects use, and then the others.

    It returns none of a file that cannot be read; whoever reads it says why.
    """
    with extra("formats", "a COLLADA file", "file"):
        from lxml import etree  # most meshes are no XML

    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=True)
    try:
        check_xml(data)
        root = etree.fromstring(data, parser)
    except (Unreadable, etree.XMLSyntaxError):
        return []

    def text(element: Any) -> str:
        return "".join(element.itertext()).strip()

    files = {image.get("id"): text(source) for image in root.iter("{*}image") for source in image.iter("{*}init_from")}
    files = {name: file.removeprefix("file:///").removeprefix("file://") for name, file in files.items() if file}
    used_images = []
    for effect in root.iter("{*}effect"):
        params: dict[str | None, str] = {}
        for param in effect.iter("{*}newparam"):
            for source in param.iter("{*}source", "{*}init_from", "{*}instance_image"):
                params.setdefault(param.get("sid"), text(source) or source.get("url", "").removeprefix("#"))
        for slot, what in _SLOTS.items():
            for texture in effect.iterfind(f".//{{*}}{slot}/{{*}}texture"):
                image = texture.get("texture")
                for _ in range(3):
                    image = params.get(image, image)
                if image in files:
                    used_images.append(Named(files[image], what))
    named = {image.name for image in used_images}
    return [*used_images, *(Named(name, "image") for name in files.values() if name not in named)]


MAX_NAMES = 500
"""Names of one file; further ones are passed over."""
_OPTIONS = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2} | dict.fromkeys(
    ("-bm", "-boost", "-texres", "-blendu", "-blendv", "-cc", "-clamp", "-imfchan", "-type"), 1
)
"""The options of a map in an MTL file, and how many values they have at most."""
_MAPS = {
    "map_kd": "texture",
    "map_ka": "ambient map",
    "map_ks": "specular map",
    "map_ns": "shininess map",
    "map_ke": "emission map",
    "map_d": "opacity map",
    "map_bump": "bump map",
    "bump": "bump map",
    "norm": "normal map",
    "map_kn": "normal map",
    "disp": "displacement map",
    "map_pr": "roughness map",
    "map_pm": "metallic map",
    "refl": "reflection map",
}
"""Role of the file that a statement of an MTL file names, by statement."""


def named_files(data: bytes, kind: str) -> list[Named]:
    """Returns the files that a file of a kind, a mesh's or `mtl`, names: each once, in their order."""
    if kind == "obj":
        named = [Named(name, "material library") for name in _lines(data, rb"[ \t]*mtllib[ \t]+([^\r\n]+)")]
    elif kind == "ply":
        named = [Named(name, "texture") for name in _lines(data, rb"comment TextureFile[ \t]+([^\r\n]+)")]
    elif kind == "mtl":
        named = [texture for line in decoded(data).splitlines() if (texture := _map(line))]
    elif kind in ("gltf", "glb"):
        named = _gltf(data)
    elif kind == "dae":
        named = collada_images(data)
    else:
        named = []
    return list(dict.fromkeys(named))[:MAX_NAMES]


def texture_name(text: str) -> tuple[str, str]:
    """Splits what a map of an MTL file states into its options and the name of a file, which may have blanks."""
    words = re.findall(r"\S+\s*", text.strip())
    taken = 0
    while taken < len(words) - 1 and (most := _OPTIONS.get(words[taken].strip().lower())):
        first = taken + 1
        taken = first + 1
        while taken < len(words) - 1 and taken - first < most and _is_number(words[taken]):
            taken += 1
    return "".join(words[:taken]).strip(), "".join(words[taken:]).strip()


def _map(line: str) -> Named | None:
    key, _, rest = line.strip().partition(" ")
    what = _MAPS.get(key.lower())
    name = texture_name(rest)[1] if what else ""
    return Named(name, what) if what and name else None


def _gltf(data: bytes) -> list[Named]:
    """Returns the buffers and images that a glTF file has outside itself; none if it is damaged."""
    try:
        if data.startswith(b"glTF"):
            (length,) = struct.unpack_from("<I", data, 12)
            data = data[20 : 20 + length]
        tree = json.loads(data.decode())  # of bytes it would guess an encoding, whose codec may be out of reach
        return [
            Named(entry["uri"], what)
            for key, what in (("buffers", "buffer"), ("images", "texture"))
            for entry in tree.get(key, [])
            if isinstance(entry.get("uri"), str) and not entry["uri"].startswith("data:")
        ]
    except (ValueError, AttributeError, TypeError, RecursionError, struct.error):
        return []


def _lines(data: bytes, pattern: bytes) -> list[str]:
    return [decoded(match[1].strip()) for match in re.finditer(rb"(?m)^" + pattern, data)]


def _is_number(word: str) -> bool:
    return re.fullmatch(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?", word.strip()) is not None


IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".gif", ".tga")


class CompanionFiles:
    """Gives a parser the files beside a mesh and refuses every other name and address; one of trimesh's resolvers.

    A texture is given only if it is an image of a known format; it raises InvalidRequest("file", …) otherwise.
    """

    def __init__(self, files: Mapping[str, bytes], kind: str = "", data: bytes = b"") -> None:
        """`files` are given by their paths relative to the folder of the mesh, which is `data` of format `kind`."""
        self._files = files
        self._images: dict[str, bytes] = {}
        self.paths = tuple(files)
        self.size = sum(map(len, files.values()))
        self.named = self._named(data, kind)
        """Files that the mesh and its material libraries name, in their order."""

    def find(self, name: str) -> str | None:
        """Returns the path of the file that a mesh calls `name`; None if it is not there.

        Exporters write any case, backslashes, escapes, and paths of their own machines: a file of the same name in any
        folder is the file if no other has that name.
        """
        for written in (name, unquote(name)):
            path = posixpath.normpath(written.strip().replace("\\", "/")).lower()
            if path in self._paths:
                return self._paths[path]
            same = [
                name for lower, name in self._paths.items() if posixpath.basename(lower) == posixpath.basename(path)
            ]
            if len(same) == 1:
                return same[0]
        return None

    def get(self, key: str) -> bytes:
        """Returns the file that a mesh calls `key`. Raises FileNotFoundError."""
        if (path := self.find(key) or self.find(texture_name(key)[1])) is None:
            raise FileNotFoundError(key)
        if path in self._libraries:
            return self.libraries().encode()  # the parser asks for the first only
        return self._images[path] if path in self._images else self._files[path]

    def data(self, path: str) -> bytes:
        """Returns the bytes of the file at a path that `find` has returned."""
        return self._files[path]

    def check(self) -> None:
        """Raises InvalidRequest("file", …) for a texture that is shown and is no image."""
        for path in filter(None, (self.find(file.name) for file in self.named if file.what == "texture")):
            if path.lower().endswith(IMAGES):
                self._images[path] = _checked(self._files[path], path)

    __getitem__ = get

    @cached_property
    def _paths(self) -> dict[str, str]:
        return {posixpath.normpath(path).lower(): path for path in self._files}

    @cached_property
    def _libraries(self) -> list[str]:
        paths = (self.find(file.name) for file in self.named if file.what == "material library")
        return list(dict.fromkeys(path for path in paths if path))

    def _named(self, data: bytes, kind: str) -> list[Named]:
        direct = named_files(data, kind)
        libraries = [self.find(file.name) for file in direct if file.what == "material library"]
        inside = [file for path in dict.fromkeys(libraries) if path for file in named_files(self._files[path], "mtl")]
        return list(dict.fromkeys([*direct, *inside]))

    def libraries(self) -> str:
        """The text of the material libraries that the mesh names and that are there."""
        return "\n".join(decoded(self._files[path]) for path in self._libraries)


def _checked(data: bytes, path: str) -> bytes:
    try:
        image = open_texture(data, path)
        if image.format in ("PNG", "JPEG", "WEBP"):
            return data
        buffer = BytesIO()
        image.convert("RGBA").save(buffer, "PNG")
        return buffer.getvalue()
    except (ValueError, OSError, SyntaxError) as error:
        message = error if isinstance(error, Unreadable) else DAMAGED
        raise InvalidRequest("file", f"the texture {path} cannot be read: {message}") from error
