"""Finds the files that a mesh file or a material library names."""

import json
import re
import struct

from services.scenes.named import Named
from services.scenes.text import decoded
from services.scenes.xml_file import collada_images

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
"""What each statement of an MTL file names."""


def named_files(data: bytes, kind: str) -> list[Named]:
    """Returns the files that a file of a kind, a mesh's or `mtl`, names: each once, in their order."""
    if kind == "obj":
        found = [Named(name, "material library") for name in _lines(data, rb"[ \t]*mtllib[ \t]+([^\r\n]+)")]
    elif kind == "ply":
        found = [Named(name, "texture") for name in _lines(data, rb"comment TextureFile[ \t]+([^\r\n]+)")]
    elif kind == "mtl":
        found = [one for line in decoded(data).splitlines() if (one := _map(line))]
    elif kind in ("gltf", "glb"):
        found = _gltf(data)
    elif kind == "dae":
        found = collada_images(data)
    else:
        found = []
    return list(dict.fromkeys(found))[:MAX_NAMES]


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
