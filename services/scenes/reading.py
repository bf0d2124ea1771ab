"""Reads untrusted mesh files."""

import re
from collections.abc import Callable
from io import BytesIO

import numpy as np
import trimesh

from services.errors import InvalidRequest, shortened
from services.scenes.about import Up
from services.scenes.beside import Beside
from services.scenes.claims import CHECKS, check_elements
from services.scenes.gltf import read_gltf
from services.scenes.gltf_file import GltfFile
from services.scenes.mesh import Part
from services.scenes.surfaces import read_surfaces, to_parts
from services.scenes.text import decoded
from services.scenes.unreadable import DAMAGED, TooLarge, Unreadable
from services.scenes.up_axis import is_z_up, upright
from services.scenes.wavefront import read_opacity

KINDS = tuple(CHECKS)
"""The file kinds that are read."""


def read_mesh(
    data: bytes,
    kind: str,
    max_faces: int,
    beside: Beside | None = None,
    up: Up | None = None,
    note: Callable[[str], None] = lambda _: None,
) -> tuple[Part, ...]:
    """Returns the parts of a mesh file, fitted to the frame. `kind` is an element of KINDS; `beside` has the materials
    and textures that it may name. `up` is the file's axis that points up; None: as its format says.
    `note` is given what its coordinates have lost (`rounding_note`).

    Raises InvalidRequest("kind", …) for an unknown kind, and InvalidRequest("file", …) if the bytes are not of that
    kind, declare more data than they hold, cannot be parsed, have no triangles or more than `max_faces`, have vertices
    that are not finite, or have no area, or if a texture is no image.
    """
    parts = _parts(data, kind, max_faces, beside or Beside({}), note)
    return upright(parts) if up == "z" or (up is None and is_z_up(data, kind)) else parts


def _parts(data: bytes, kind: str, max_faces: int, beside: Beside, note: Callable[[str], None]) -> tuple[Part, ...]:
    if kind not in CHECKS:
        raise InvalidRequest("kind", f"{kind!r} meshes are not read; one of {', '.join(KINDS)} is")
    if not data.strip():
        raise InvalidRequest("file", "it is empty")
    try:
        CHECKS[kind](data, max_faces)
        # Suppress numpy's warnings: numbers that are not finite are reported by name.
        with np.errstate(all="ignore"):
            if kind in ("glb", "gltf"):
                file = GltfFile(data.removeprefix(b"\xef\xbb\xbf"), beside)
                check_elements(file, len(data) + beside.size, max_faces)
                return read_gltf(file, max_faces, note)
            beside.check()
            text = decoded(data).encode() if kind in ("obj", "off") else _in_doubles(data) if kind == "ply" else data
            scene = trimesh.load_scene(BytesIO(text), file_type=kind, resolver=beside, process=False)
    except (MemoryError, InvalidRequest):
        raise
    except TooLarge as error:
        raise InvalidRequest("file", str(error)) from error
    except Exception as error:  # parsers raise many types of exceptions; in every case the file is invalid
        said = shortened(error) if isinstance(error, Unreadable) else DAMAGED
        raise InvalidRequest("file", f"it is not a readable {kind} mesh: {said}") from error
    count = triangles(scene)
    if count > max_faces:
        raise InvalidRequest("file", str(TooLarge(count, "triangles", max_faces)))
    try:
        # Nobody sends what cannot be seen: an opacity of 0 is a writer's mistake, of `Tr` above all.
        opacity = {name: value or 1.0 for name, value in read_opacity(beside.libraries()).items()}
        return to_parts(read_surfaces(scene, opacity), note=note)
    except (ValueError, OSError, SyntaxError) as error:  # a damaged texture is an OSError or a SyntaxError of Pillow
        is_ours = isinstance(error, Unreadable)
        said = shortened(error) if is_ours else "a texture or its coordinates are damaged, or cut off"
        raise InvalidRequest("file", f"it cannot be shown: {said}") from error


def _in_doubles(ply: bytes) -> bytes:
    """Declares the coordinates of a PLY file in text as 64-bit numbers: its digits may be more than 32 bits hold."""
    header, end, body = ply.partition(b"end_header")
    if not re.search(rb"(?m)^format ascii\b", header):
        return ply
    return (
        re.sub(rb"(?m)^property[ \t]+float(?:32)?[ \t]+([xyz])[ \t]*(?=\r?$)", rb"property double \1", header)
        + end
        + body
    )


def triangles(scene: trimesh.Scene) -> int:
    """Returns the number of triangles of a scene over all instances, without creating the instances."""
    counts = {name: len(getattr(geometry, "faces", ())) for name, geometry in scene.geometry.items()}
    return sum(counts[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
