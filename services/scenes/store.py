"""Processed meshes on disk, so that the second time is fast. Safe to delete at any moment."""

import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np

from services import atomic_write
from services.scenes.mesh import Part

FORMAT = 1
"""Part of every file's name: raise it when anything that decides a processed mesh changes."""


def mesh_path(directory: Path, key: str) -> Path:
    """Where the processed mesh of a source with this digest is kept."""
    return directory / f"{key}-v{FORMAT}.npz"


def save_parts(path: Path, parts: tuple[Part, ...]) -> None:
    """Write parts as an uncompressed .npz, atomically."""
    arrays = {
        f"{k}.{name}": value for k, part in enumerate(parts) for name, value in vars(part).items() if value is not None
    }
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
                    )
                    for k in range(count)
                )
                or None
            )
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile):
        return None
