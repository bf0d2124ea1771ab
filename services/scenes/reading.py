"""Reading a mesh file that nobody vouches for."""

from collections.abc import Iterable
from io import BytesIO
from typing import Any

import numpy as np
import trimesh

from services.errors import InvalidRequest
from services.scenes.claims import CHECKS
from services.scenes.gltf import read_gltf
from services.scenes.mesh import Part
from services.scenes.surfaces import read_surfaces, to_parts

KINDS = tuple(CHECKS)


class _Nothing(trimesh.resolvers.Resolver):  # type: ignore[misc]  # trimesh has no types
    """Refuses every file or address that a mesh names: only the uploaded bytes are read."""

    def __init__(self) -> None:
        pass

    def get(self, key: str) -> bytes:
        raise FileNotFoundError(key)

    def keys(self) -> Iterable[str]:
        return ()

    def write(self, name: str, data: Any) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> "_Nothing":
        raise FileNotFoundError(namespace)


def read_mesh(data: bytes, kind: str, max_faces: int) -> tuple[Part, ...]:
    """The parts of a mesh file, fitted to the frame.

    kind: one of KINDS. Raises InvalidRequest("kind", …) for another, and InvalidRequest("file", …) if the bytes are
    not what the kind says, declare more than they hold, cannot be parsed, have no triangles or more than `max_faces`,
    have vertices that are not finite, or have no area.
    """
    if kind not in CHECKS:
        raise InvalidRequest("kind", f"{kind!r} meshes are not read; one of {', '.join(KINDS)} is")
    if not data.strip():
        raise InvalidRequest("file", "it is empty")
    try:
        CHECKS[kind](data, max_faces)
        if kind == "glb":
            return read_gltf(data, max_faces)
        # Numbers that are not finite are reported below, by name, not by whichever product met them first.
        with np.errstate(all="ignore"):
            scene = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=_Nothing(), process=False)
    except ValueError as error:
        raise InvalidRequest("file", f"it is not a readable {kind} mesh: {error}") from error
    except Exception as error:  # whatever a parser of five formats trips over, the file was wrong
        raise InvalidRequest("file", f"it is not a readable {kind} mesh ({type(error).__name__})") from error
    count = triangles(scene)
    if count > max_faces:
        raise InvalidRequest("file", f"it has {count:,} triangles; at most {max_faces:,} are taken")
    try:
        return to_parts(read_surfaces(scene))
    except (ValueError, OSError, SyntaxError) as error:  # a damaged texture is an OSError or a SyntaxError of Pillow
        raise InvalidRequest("file", f"it cannot be shown: {error}") from error


def triangles(scene: trimesh.Scene) -> int:
    """Triangles of a scene, counting every instance, without making any of them."""
    counts = {name: len(getattr(geometry, "faces", ())) for name, geometry in scene.geometry.items()}
    return sum(counts[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
