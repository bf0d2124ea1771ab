"""Reads the furniture's Wavefront OBJ files from memory, through trimesh."""

import posixpath
import re
from collections.abc import Iterable
from io import BytesIO
from typing import Any

import trimesh

from services.scenes.surfaces import Surface, read_surfaces


def read_obj(files: dict[str, bytes], name: str) -> list[Surface]:
    """Returns the surfaces of the model in the file `name`; `files` holds it, its material library and its textures."""
    resolver = _Members(files)
    obj = files[name]
    opacity: dict[str, float] = {}
    library = re.search(rb"^\s*mtllib\s+(.+?)\s*$", obj, re.MULTILINE)
    if library is not None:
        try:
            opacity = read_opacity(resolver.get(library[1].decode("latin-1")).decode("latin-1"))
        except KeyError:
            opacity = {}
    scene = trimesh.load_scene(BytesIO(obj), file_type="obj", resolver=resolver, process=False)
    return read_surfaces(scene, opacity)


def read_opacity(mtl: str) -> dict[str, float]:
    """Returns the opacity in [0,1] of each material in an MTL file that states it: `d`, or else 1 − `Tr`."""
    opacity: dict[str, float] = {}
    dissolved: set[str] = set()
    name = ""
    for words in (line.split() for line in mtl.splitlines()):
        if len(words) < 2:
            continue
        key = words[0].lower()
        if key == "newmtl":
            name = " ".join(words[1:])
        elif key == "d" or (key == "tr" and name not in dissolved):
            try:
                value = float(words[-1])
            except ValueError:
                continue
            opacity[name] = min(max(value if key == "d" else 1 - value, 0.0), 1.0)
            if key == "d":
                dissolved.add(name)
    return opacity


class _Members(trimesh.resolvers.Resolver):  # type: ignore[misc]  # trimesh has no types
    """Resolves names to the files of a model and to no others."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self._files = {name.lower(): data for name, data in files.items()}

    def get(self, key: str) -> bytes:
        # Exporters write any case, backslashes and absolute paths; the file itself may lie beside the model.
        path = posixpath.normpath(key.strip().replace("\\", "/")).lower()
        return self._files[path if path in self._files else posixpath.basename(path)]

    def keys(self) -> Iterable[str]:
        return self._files.keys()

    def write(self, name: str, data: Any) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> "_Members":
        raise NotImplementedError
