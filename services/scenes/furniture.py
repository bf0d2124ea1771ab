"""Loads a furniture model from its archive as a mesh: turned upright, scaled to its catalogue size, fitted."""

import hashlib
import posixpath
import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from services.errors import JobFailure
from services.scenes.catalogue import CATALOGUE, Model
from services.scenes.mesh import Mesh, Part
from services.scenes.properties import write_properties
from services.scenes.store import load_parts, mesh_path, save_parts

if TYPE_CHECKING:
    from services.scenes.surfaces import Surface


def load_model(model: Model, furniture: Path, cache: Path) -> Mesh:
    """Returns the mesh of a catalogue model.

    `furniture` is the directory of the archives, `cache` that of processed meshes. The mesh's sha256 covers the model's
    size and rotation and every file it uses. Raises JobFailure("asset-missing") if the archive is missing or damaged.
    """
    files = _read(model, furniture)
    digest = _digest(model, files)
    kept = mesh_path(cache, digest)
    parts = load_parts(kept)
    if parts is None:
        # trimesh takes half a second to import, and a cached mesh does not need it
        from services.scenes.surfaces import to_parts
        from services.scenes.wavefront import read_obj

        parts = to_parts(upright(model, read_obj(files, posixpath.basename(model.path))))
        save_parts(kept, parts)
    return Mesh(parts=parts, sha256=digest, credit=model.credit, centimetres=_centimetres(model, parts))


def archive_of(model: Model, furniture: Path) -> bytes:
    """Returns a furniture library, a `*.sh3f` file, of one model under the slug that it has in the whole library.

    Raises JobFailure("asset-missing") if the archive is missing or damaged.
    """
    width, depth, height = model.size
    values = {
        "name": model.library,
        "license": model.licence,
        "slug#1": model.slug,
        "id#1": model.key,
        "name#1": model.title,
        "category#1": model.category,
        "creator#1": model.creator,
        "model#1": f"/{model.path}",
        "width#1": repr(width),
        "depth#1": repr(depth),
        "height#1": repr(height),
        "modelRotation#1": " ".join(map(repr, model.rotation)),
    }
    folder, buffer = posixpath.dirname(model.path), BytesIO()
    files = {f"{folder}/{name}": data for name, data in _read(model, furniture).items()}
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in ((CATALOGUE, write_properties(values)), *files.items()):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def read_icon(model: Model, furniture: Path) -> bytes | None:
    """Returns the PNG file of the picture that the archive has of the model; None if it has none that can be read."""
    if model.icon is None:
        return None
    try:
        with zipfile.ZipFile(furniture / model.archive) as archive:
            data = archive.read(model.icon)
    except (OSError, KeyError, zipfile.BadZipFile):
        return None
    return data if data.startswith(b"\x89PNG\r\n\x1a\n") else None


def upright(model: Model, surfaces: "list[Surface]") -> "list[Surface]":
    """Returns the surfaces turned by the model's rotation and scaled to its width, height and depth, in centimetres.

    An axis along which the model has no extent (a flat image) is not scaled.
    """
    rotation = np.asarray(model.rotation, np.float64).reshape(3, 3)
    turned = [surface.vertices @ rotation.T for surface in surfaces]
    used = np.concatenate([v[np.unique(s.faces)] for v, s in zip(turned, surfaces, strict=True) if len(s.faces)])
    extent = used.max(axis=0) - used.min(axis=0)
    width, depth, height = model.size
    flat = extent < 1e-9 * extent.max()
    scale = np.where(flat, 1.0, np.array([width, height, depth]) / np.where(flat, 1.0, extent))
    return [replace(surface, vertices=v * scale) for surface, v in zip(surfaces, turned, strict=True)]


def _centimetres(model: Model, parts: tuple[Part, ...]) -> float:
    """Returns the real length of a unit of the fitted mesh, from its longest side and the catalogue's."""
    points = np.concatenate([part.vertices[np.unique(part.faces)] for part in parts]).astype(np.float64)
    extent = points.max(axis=0) - points.min(axis=0)
    width, depth, height = model.size
    longest = int(extent.argmax())
    return float((width, height, depth)[longest] / extent[longest])


def _read(model: Model, furniture: Path) -> dict[str, bytes]:
    """Returns the files of a model. Raises JobFailure("asset-missing") if its archive is missing or damaged."""
    try:
        with zipfile.ZipFile(furniture / model.archive) as archive:
            return _files(archive, model.path)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise JobFailure("asset-missing", f"cannot read {model.archive}: {error}; run scripts/setup again") from error


def _files(archive: zipfile.ZipFile, path: str) -> dict[str, bytes]:
    """Returns the contents of the model's OBJ file, material libraries and textures, by name relative to its folder."""
    archive.getinfo(path)  # raises KeyError if the model itself is missing
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
