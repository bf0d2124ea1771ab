"""Meshes of short edges, for surfaces that are to be bent: a long triangle stays flat between its corners."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scene_attack.scenes.mesh import Doubles, Longs, Mesh, Part

MOST = 2_000_000
"""Triangles that a divided mesh is expected to have at most: 0.6 GB, and six seconds to make."""


def pieces(mesh: Mesh, longest: float) -> int:
    """About how many triangles `divided` makes, too many rather than too few: a triangle of which all edges are long
    becomes four, of which two are long three, and of which one is long two."""
    count = 0.0
    for part in mesh.parts:
        corners = part.vertices.astype(np.float64)[part.faces]
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
        halvings = np.sort(np.ceil(np.log2(np.maximum(edges / longest, 1.0))), axis=1)
        shortest, middle, most = halvings.T
        count += float((4.0**shortest * 3.0 ** (middle - shortest) * 2.0 ** (most - middle)).sum())
    return int(count)


@lru_cache(maxsize=8)
def divided(mesh: Mesh, longest: float) -> Mesh:
    """The same surface, each edge of its triangles at most `longest` scene units.

    Edges are halved until none is longer, each in all triangles that have it, so that no gap opens between neighbours,
    whether they share vertices or have vertices at the same places. The attributes of new vertices are means, which is
    what is between two vertices in an image of the mesh.
    """
    return replace(mesh, parts=tuple(_divided(part, longest) for part in mesh.parts))


def _divided(part: Part, longest: float) -> Part:
    material = part.metallic_roughness
    of_material = [] if material is None else [material.tangents, material.second_uv, material.vertex_colors]
    uv = [] if part.uv is None else [part.uv]
    attributes = [part.vertices, part.normals, *uv, *of_material]
    values, faces = np.concatenate(attributes, axis=1).astype(np.float64), part.faces.astype(np.int64)
    while True:
        corners = values[faces, :3]
        long = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=-1) > longest**2  # edge k is from corner k on
        if not long.any():
            break
        values, faces = _halved(values, faces, long)
    ends = np.cumsum([of.shape[1] for of in attributes])[:-1]
    vertices, normals, *rest = np.split(values.astype(np.float32), ends, axis=1)
    if material is not None:
        tangents, second_uv, colors = rest[-3:]
        material = replace(material, tangents=tangents, second_uv=second_uv, vertex_colors=colors)
    return replace(
        part,
        vertices=vertices,
        normals=normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30),
        uv=rest[0] if uv else None,
        faces=faces.astype(np.int32),
        metallic_roughness=material,
    )


def _halved(values: Doubles, faces: Longs, long: NDArray[np.bool_]) -> tuple[Doubles, Longs]:
    """The attributes [V, K] and faces [F, 3] with the edges `long` [F, 3] halved."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)[long]
    ends.sort(axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    middle = np.full(faces.shape, -1)
    middle[long] = len(values) + number.ravel()
    children = [faces[~long.any(axis=1)]]
    for turn in range(3):  # each pattern of long edges, turned so that the first edge is long
        (a, b, c), (ab, bc, ca) = np.roll(faces, -turn, axis=1).T, np.roll(middle, -turn, axis=1).T
        one = (ab >= 0) & (bc < 0) & (ca < 0)
        two = (ab >= 0) & (bc >= 0) & (ca < 0)
        three = (ab >= 0) & (bc >= 0) & (ca >= 0) & (turn == 0)
        for which, triangles in (
            (one, ((a, ab, c), (ab, b, c))),
            (two, ((ab, b, bc), (a, ab, bc), (a, bc, c))),
            (three, ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))),
        ):
            children += [np.stack(corners, axis=1)[which] for corners in triangles]
    return np.concatenate([values, values[edges].mean(axis=1)]), np.concatenate(children)
