"""Caches processed meshes on disk. The files may be deleted at any time."""

import json
import os
import zipfile
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from services import disk
from services.scenes.mesh import VERTEX_ATTRIBUTES, MetallicRoughness, Part, TextureMap

FORMAT = 3
"""Version of the cache, part of every file's name. Increase it with any change to the processing of meshes."""


def mesh_path(directory: Path, key: str) -> Path:
    """Returns the path of the processed mesh of a source, whose digest is part of `key`."""
    return directory / f"{key}-v{FORMAT}.npz"


def save_parts(path: Path, parts: tuple[Part, ...]) -> None:
    """Writes parts as an uncompressed .npz file, atomically."""
    arrays: dict[str, Any] = {}
    for k, part in enumerate(parts):
        fields = {name: value for name, value in vars(part).items() if value is not None}
        material = fields.pop("metallic_roughness", None)
        arrays |= {f"{k}.{name}": value for name, value in fields.items()}
        if material is not None:
            arrays |= _material_arrays(f"{k}.metallic_roughness", material)
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
            names = set(arrays.files)
            count = len({name.partition(".")[0] for name in names})
            return (
                tuple(
                    Part(
                        vertices=arrays[f"{k}.vertices"],
                        normals=arrays[f"{k}.normals"],
                        faces=arrays[f"{k}.faces"],
                        uv=arrays[f"{k}.uv"] if f"{k}.uv" in names else None,
                        color=arrays[f"{k}.color"],
                        texture=arrays[f"{k}.texture"] if f"{k}.texture" in names else None,
                        metallic_roughness=_material(arrays, f"{k}.metallic_roughness")
                        if f"{k}.metallic_roughness" in names
                        else None,
                    )
                    for k in range(count)
                )
                or None
            )
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile):
        return None


def _material_arrays(key: str, material: MetallicRoughness) -> dict[str, Any]:
    """Returns a material as arrays whose names begin with `key`; its scalar and text fields are JSON."""
    fields = dict(vars(material))
    arrays = {f"{key}.{name}": fields.pop(name) for name in VERTEX_ATTRIBUTES}
    maps = fields.pop("maps")
    arrays |= {f"{key}.{name}": texture_map.texels for name, texture_map in maps.items()}
    fields["maps"] = {name: (texture_map.uv_set, texture_map.wrap) for name, texture_map in maps.items()}
    return arrays | {key: np.array(json.dumps(fields))}


def _material(arrays: Any, key: str) -> MetallicRoughness:
    fields = json.loads(str(arrays[key]))
    fields["emissive"] = tuple(fields["emissive"])
    fields["maps"] = {
        name: TextureMap(arrays[f"{key}.{name}"], uv_set, (wrap[0], wrap[1]))
        for name, (uv_set, wrap) in fields["maps"].items()
    }
    return MetallicRoughness(**fields, **{name: arrays[f"{key}.{name}"] for name in VERTEX_ATTRIBUTES})
