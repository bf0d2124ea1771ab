"""Processed meshes as arrays by name, and a cache of them on disk, whose files may be deleted at any time."""

import json
import os
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene_attack import disk
from scene_attack.scenes.mesh import VERTEX_ATTRIBUTES, MetallicRoughness, Part, TextureMap

FORMAT = 3
"""Version of the cache, part of every file's name. Increase it with any change to the processing of meshes."""


def mesh_path(directory: Path, key: str) -> Path:
    """Returns the path of the processed mesh of a source, whose digest is part of `key`."""
    return directory / f"{key}-v{FORMAT}.npz"


def to_arrays(parts: tuple[Part, ...]) -> dict[str, NDArray[Any]]:
    """Returns the arrays of parts by name, "0.vertices"; the settings of a material are a text of JSON."""
    arrays: dict[str, NDArray[Any]] = {}
    for k, part in enumerate(parts):
        own = {name: value for name, value in vars(part).items() if value is not None}
        material = own.pop("metallic_roughness", None)
        arrays |= {f"{k}.{name}": value for name, value in own.items()}
        if material is not None:
            arrays |= _material_arrays(f"{k}.metallic_roughness", material)
    return arrays


def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> tuple[Part, ...]:
    """Returns the parts whose arrays `to_arrays` has returned. Raises KeyError or TypeError if one is missing."""
    parts = []
    for k in range(len({name.partition(".")[0] for name in arrays})):
        names = [field.name for field in fields(Part) if f"{k}.{field.name}" in arrays]
        settings: dict[str, Any] = {name: arrays[f"{k}.{name}"] for name in names}
        if "metallic_roughness" in settings:
            settings["metallic_roughness"] = _material(arrays, f"{k}.metallic_roughness")
        parts.append(Part(**settings))
    return tuple(parts)


def save_parts(path: Path, parts: tuple[Part, ...]) -> None:
    """Writes parts as an uncompressed .npz file, atomically."""
    arrays: dict[str, Any] = to_arrays(parts)
    with disk.replacing(path) as part_path, part_path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def limit(directory: Path, most: int) -> None:
    """Removes the meshes that were not used for longest, until the others take at most `most` bytes."""
    files = []
    for path in directory.glob("*.npz"):
        with suppress(FileNotFoundError):  # removed meanwhile
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= most:
            return
        path.unlink(missing_ok=True)
        total -= size


def load_parts(path: Path) -> tuple[Part, ...] | None:
    """Reads the parts written by `save_parts`; returns None if the file is missing or damaged."""
    try:
        data = path.read_bytes()
        with suppress(OSError):  # of a cache that is read-only
            os.utime(path)  # `limit` keeps what was used last
        with np.load(BytesIO(data), allow_pickle=False) as arrays:
            return from_arrays(arrays) or None
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile):
        return None


def _material_arrays(key: str, material: MetallicRoughness) -> dict[str, Any]:
    """Returns a material as arrays whose names begin with `key`; its scalar and text fields are JSON."""
    settings = dict(vars(material))
    arrays = {f"{key}.{name}": settings.pop(name) for name in VERTEX_ATTRIBUTES}
    maps = settings.pop("maps")
    arrays |= {f"{key}.{name}": texture_map.texels for name, texture_map in maps.items()}
    settings["maps"] = {name: (texture_map.uv_set, texture_map.wrap) for name, texture_map in maps.items()}
    return arrays | {key: np.array(json.dumps(settings))}


def _material(arrays: Mapping[str, NDArray[Any]], key: str) -> MetallicRoughness:
    settings = json.loads(str(arrays[key]))
    settings["emissive"] = tuple(settings["emissive"])
    settings["maps"] = {
        name: TextureMap(arrays[f"{key}.{name}"], uv_set, (wrap[0], wrap[1]))
        for name, (uv_set, wrap) in settings["maps"].items()
    }
    settings |= {name: arrays[f"{key}.{name}"] for name in VERTEX_ATTRIBUTES}
    return MetallicRoughness(**settings)
