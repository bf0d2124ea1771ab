"""One furniture model, from its archive to a mesh: materials, upright, stretched to its catalogue size, fitted."""

import hashlib
import posixpath
import re
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from services.errors import JobFailure
from services.scenes.catalogue import Model
from services.scenes.mesh import Mesh
from services.scenes.store import load_parts, mesh_path, save_parts
from services.scenes.surfaces import Surface, read_surfaces, to_parts


def load_model(model: Model, furniture: Path, cache: Path) -> Mesh:
    """The mesh of a catalogue model.

    furniture: the directory of the archives; cache: where processed meshes are kept. Its sha256 is that of the model
    and every file it uses. Raises JobFailure("asset-missing") if the archive has gone or is damaged.
    """
    try:
        with zipfile.ZipFile(furniture / model.archive) as archive:
            files = _files(archive, model.path)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise JobFailure("asset-missing", f"cannot read {model.archive}: {error}; run scripts/setup again") from error
    digest = _digest(model, files)
    kept = mesh_path(cache, digest)
    parts = load_parts(kept)
    if parts is None:
        parts = to_parts(upright(model, _surfaces(files, model.path)))
        save_parts(kept, parts)
    return Mesh(parts=parts, sha256=digest, credit=model.credit)


def upright(model: Model, surfaces: list[Surface]) -> list[Surface]:
    """Surfaces turned by the model's rotation and stretched to its width, height and depth, in centimetres.

    A side without extent (a flat picture) keeps what it has.
    """
    rotation = np.asarray(model.rotation, np.float64).reshape(3, 3)
    turned = [surface.vertices @ rotation.T for surface in surfaces]
    used = np.concatenate([v[np.unique(s.faces)] for v, s in zip(turned, surfaces, strict=True) if len(s.faces)])
    extent = used.max(axis=0) - used.min(axis=0)
    width, depth, height = model.size
    flat = extent < 1e-9 * extent.max()
    scale = np.where(flat, 1.0, np.array([width, height, depth]) / np.where(flat, 1.0, extent))
    return [replace(surface, vertices=v * scale) for surface, v in zip(surfaces, turned, strict=True)]


def read_opacity(mtl: str) -> dict[str, float]:
    """Opacity of each material of an MTL file that gives one: `d`, or else one minus `Tr`; within [0,1]."""
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
    """Hands out the files of one model and nothing else."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self._files = {name.lower(): data for name, data in files.items()}

    def get(self, key: str) -> bytes:
        # Exporters write any case, backslashes, and where the file was on their own disk; it may be beside the model.
        path = posixpath.normpath(key.strip().replace("\\", "/")).lower()
        return self._files[path if path in self._files else posixpath.basename(path)]

    def keys(self) -> Iterable[str]:
        return self._files.keys()

    def write(self, name: str, data: Any) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> "_Members":
        raise NotImplementedError


def _files(archive: zipfile.ZipFile, path: str) -> dict[str, bytes]:
    """The model's own files by name relative to it: OBJ, its material library, its textures."""
    archive.getinfo(path)  # a KeyError if the model itself is not there
    folder = posixpath.dirname(path) + "/"
    names = sorted(name for name in archive.namelist() if name.startswith(folder) and not name.endswith("/"))
    wanted = (".obj", ".mtl", ".png", ".jpg", ".jpeg", ".bmp", ".gif")
    return {
        name.removeprefix(folder): archive.read(name)
        for name in names
        if name == path or (name.lower().endswith(wanted) and not name.lower().endswith(".obj"))
    }


def _digest(model: Model, files: dict[str, bytes]) -> str:
    digest = hashlib.sha256(repr((model.size, model.rotation)).encode())
    for name, data in sorted(files.items()):
        digest.update(f"\n{name}\n{len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def _surfaces(files: dict[str, bytes], path: str) -> list[Surface]:
    resolver = _Members(files)
    obj = files[posixpath.basename(path)]
    opacity: dict[str, float] = {}
    library = re.search(rb"^\s*mtllib\s+(.+?)\s*$", obj, re.MULTILINE)
    if library is not None:
        try:
            opacity = read_opacity(resolver.get(library[1].decode("latin-1")).decode("latin-1"))
        except KeyError:
            opacity = {}
    scene = trimesh.load_scene(BytesIO(obj), file_type="obj", resolver=resolver, process=False)
    return read_surfaces(scene, opacity)
