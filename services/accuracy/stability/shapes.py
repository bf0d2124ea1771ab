"""Objects of a few triangles whose every corner is known."""

import numpy as np
import trimesh

from services.scenes.mesh import Bytes, Doubles, Part

SIDES = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
"""The two triangles of a quadrilateral, counter-clockwise."""


def square(side: float, texture: Bytes | None = None, repeats: float = 1.0) -> tuple[Part, ...]:
    """A white square in z = 0 that faces +z, in scene units, its uv from (0, 0) at the lower left to `repeats`."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64)
    return (_part(np.append(corners * side / 2, np.zeros((4, 1)), axis=1), (0, 0, 1), corners, texture, repeats),)


def box(centre: tuple[float, float, float], side: float) -> tuple[Part, ...]:
    """A white axis-parallel cube, six parts."""
    parts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v, out = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3], sign * np.eye(3)[axis]
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ np.stack([u, v]) + out
            corners = corners if sign > 0 else corners[::-1]
            parts.append(_part(np.asarray(centre) + side / 2 * corners, tuple(out), corners[:, :2], None, 1.0))
    return tuple(parts)


def ball(radius: float) -> tuple[Part, ...]:
    """A white sphere of 80 large faces and smooth normals: between its corners these are much shorter than 1."""
    mesh = trimesh.creation.icosphere(subdivisions=1)
    corners = np.asarray(mesh.vertices, np.float32)
    return (Part(radius * corners, corners, np.asarray(mesh.faces, np.int32), None, np.ones(4, np.float32), None),)


def _part(
    vertices: Doubles, normal: tuple[float, ...], corners: Doubles, texture: Bytes | None, repeats: float
) -> Part:
    return Part(
        vertices=vertices.astype(np.float32),
        normals=np.tile(np.array(normal, np.float32), (4, 1)),
        faces=SIDES,
        uv=None if texture is None else (repeats * (corners + 1) / 2).astype(np.float32),
        color=np.ones(4, np.float32),
        texture=texture,
    )
