"""Derives tangents from texture coordinates, for normal maps of meshes without tangents."""

from typing import NamedTuple

import numpy as np

from services.scenes.mesh import Doubles, Longs


class Tangents(NamedTuple):
    """Vertices with tangents.

    source: int64 [V], the index of the input vertex that each vertex copies. tangents: float64 [V,4], unit, orthogonal
    to the normal, with the sign of the bitangent cross(n, t). faces: int64 [F,3], indices of these vertices.
    """

    source: Longs
    tangents: Doubles
    faces: Longs


def derive_tangents(vertices: Doubles, normals: Doubles, uv: Doubles, faces: Longs) -> Tangents:
    """Computes the direction of increasing u at each vertex: the area-weighted mean over its faces (Lengyel 2001).

    vertices and normals are [V,3], uv [V,2] with v upwards, faces [F,3]. A vertex between faces whose texture is
    mirrored and faces whose texture is not is split. Where the texture coordinates span no area, the tangent is
    arbitrary.
    """
    first, second = (vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2))
    du1, dv1 = (uv[faces[:, 1]] - uv[faces[:, 0]]).T
    du2, dv2 = (uv[faces[:, 2]] - uv[faces[:, 0]]).T
    area = du1 * dv2 - du2 * dv1
    sign = np.where(area < 0, -1.0, 1.0)
    along = sign[:, None] * (first * dv2[:, None] - second * dv1[:, None])
    # Weighted by the area on the surface instead of 1 / area in texture space, which is unbounded.
    length = np.linalg.norm(along, axis=1, keepdims=True)
    weight = np.linalg.norm(np.cross(first, second), axis=1, keepdims=True)
    along = np.where(length > 0, along / np.where(length > 0, length, 1) * weight, 0.0)

    mirrored = np.repeat(area < 0, 3)
    pairs, corner = np.unique(faces.ravel() * 2 + mirrored, return_inverse=True)
    source, flipped = pairs // 2, pairs % 2 == 1
    sums = np.stack([np.bincount(corner.ravel(), np.repeat(along[:, k], 3), len(pairs)) for k in range(3)], axis=1)
    normal = normals[source]
    # Where the texture gives no tangent, project the coordinate axis that is most perpendicular to the normal.
    spare = np.eye(3)[np.abs(normal).argmin(axis=1)]
    candidates = [direction - normal * (normal * direction).sum(1, keepdims=True) for direction in (sums, spare)]
    lengths = [np.linalg.norm(candidate, axis=1, keepdims=True) for candidate in candidates]
    usable = lengths[0] > 1e-9 * np.linalg.norm(sums, axis=1, keepdims=True)
    tangents = np.where(usable, candidates[0], candidates[1]) / np.where(
        usable, lengths[0], np.maximum(lengths[1], 1e-9)
    )
    handed = np.append(tangents, np.where(flipped, -1.0, 1.0)[:, None], axis=1)
    return Tangents(source, handed, corner.reshape(-1, 3))
