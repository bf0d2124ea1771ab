"""Reads untrusted mesh files."""

from collections.abc import Iterable
from io import BytesIO
from typing import Any

import numpy as np
import trimesh

from services.errors import InvalidRequest, shortened
from services.scenes.claims import CHECKS
from services.scenes.gltf import read_gltf
from services.scenes.mesh import Part
from services.scenes.surfaces import read_surfaces, to_parts

KINDS = tuple(CHECKS)
"""The file kinds that are read."""


class _NoFiles(trimesh.resolvers.Resolver):  # type: ignore[misc]  # trimesh has no types
    """Refuses every file or address that a mesh names: only the uploaded bytes are read."""

    def __init__(self) -> None:
        pass

    def get(self, key: str) -> bytes:
        raise FileNotFoundError(key)

    def keys(self) -> Iterable[str]:
        return ()

    def write(self, name: str, data: Any) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> "_NoFiles":
        raise FileNotFoundError(namespace)


def read_mesh(data: bytes, kind: str, max_faces: int) -> tuple[Part, ...]:
    """Returns the parts of a mesh file, fitted to the frame. `kind` is an element of KINDS.

    Raises InvalidRequest("kind", …) for an unknown kind, and InvalidRequest("file", …) if the bytes are not of that
    kind, declare more data than they hold, cannot be parsed, have no triangles or more than `max_faces`, have vertices
    that are not finite, or have no area.
    """
    if kind not in CHECKS:
        raise InvalidRequest("kind", f"{kind!r} meshes are not read; one of {', '.join(KINDS)} is")
    if not data.strip():
        raise InvalidRequest("file", "it is empty")
    try:
        CHECKS[kind](data, max_faces)
        # Suppress numpy's warnings: numbers that are not finite are reported by name.
        with np.errstate(all="ignore"):
            if kind == "glb":
                return read_gltf(data, max_faces)
            text = _utf8(data) if kind in ("obj", "off") else data
            scene = trimesh.load_scene(BytesIO(text), file_type=kind, resolver=_NoFiles(), process=False)
    except MemoryError:
        raise
    except ValueError as error:
        raise InvalidRequest("file", f"it is not a readable {kind} mesh: {shortened(error)}") from error
    except Exception as error:  # parsers raise many types of exceptions; in every case the file is invalid
        raise InvalidRequest("file", f"it is not a readable {kind} mesh ({type(error).__name__})") from error
    count = triangles(scene)
    if count > max_faces:
        raise InvalidRequest("file", f"it has {count:,} triangles; at most {max_faces:,} are taken")
    try:
        return to_parts(read_surfaces(scene))
    except (ValueError, OSError, SyntaxError) as error:  # a damaged texture is an OSError or a SyntaxError of Pillow
        raise InvalidRequest("file", f"it cannot be shown: {shortened(error)}") from error


def _utf8(data: bytes) -> bytes:
    """Returns text as UTF-8. Other text is taken as Latin-1: names of materials and comments may be in any encoding."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data


def triangles(scene: trimesh.Scene) -> int:
    """Returns the number of triangles of a scene over all instances, without creating the instances."""
    counts = {name: len(getattr(geometry, "faces", ())) for name, geometry in scene.geometry.items()}
    return sum(counts[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
