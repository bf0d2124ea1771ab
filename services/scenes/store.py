"""Processed meshes on disk, so that the second time is fast. Safe to delete at any moment."""

import json
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from services import atomic_write
from services.scenes.mesh import MetallicRoughness, Part, TextureMap

FORMAT = 2
"""Part of every file's name: raise it when anything that decides a processed mesh changes."""
VERTEX_ATTRIBUTES = ("tangents", "second_uv", "vertex_colors")
"""The arrays of a `MetallicRoughness`."""


def mesh_path(directory: Path, key: str) -> Path:
    """Where the processed mesh of a source with this digest is kept."""
    return directory / f"{key}-v{FORMAT}.npz"


def save_parts(path: Path, parts: tuple[Part, ...]) -> None:
    """Write parts as an uncompressed .npz, atomically."""
    arrays: dict[str, Any] = {}
    for k, part in enumerate(parts):
        fields = {name: value for name, value in vars(part).items() if value is not None}
        material = fields.pop("metallic_roughness", None)
        arrays |= {f"{k}.{name}": value for name, value in fields.items()}
        if material is not None:
            arrays |= _material_arrays(f"{k}.metallic_roughness", material)
    buffer = BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    atomic_write.write(path, buffer.getvalue())


def load_parts(path: Path) -> tuple[Part, ...] | None:
    """The parts written by `save_parts`; None if there is no such file or it is damaged."""
    try:
        with np.load(BytesIO(path.read_bytes()), allow_pickle=False) as arrays:
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
    """A material as arrays named after `key`, its numbers and words as JSON."""
    fields = dict(vars(material))
    arrays = {f"{key}.{name}": fields.pop(name) for name in VERTEX_ATTRIBUTES}
    maps = fields.pop("maps")
    arrays |= {f"{key}.{name}": one.texels for name, one in maps.items()}
    fields["maps"] = {name: (one.uv_set, one.wrap) for name, one in maps.items()}
    return arrays | {key: np.array(json.dumps(fields))}


def _material(arrays: Any, key: str) -> MetallicRoughness:
    fields = json.loads(str(arrays[key]))
    fields["emissive"] = tuple(fields["emissive"])
    fields["maps"] = {
        name: TextureMap(arrays[f"{key}.{name}"], uv_set, (wrap[0], wrap[1]))
        for name, (uv_set, wrap) in fields["maps"].items()
    }
    return MetallicRoughness(**fields, **{name: arrays[f"{key}.{name}"] for name in VERTEX_ATTRIBUTES})
