"""Tangents of a surface along its texture coordinates, for normal maps without tangents of their own."""

from typing import NamedTuple

import numpy as np

from services.scenes.mesh import Doubles, Longs


class Tangents(NamedTuple):
    """`source` int64 [V]: the input vertex each vertex is a copy of; `tangents` float64 [V,4]: unit, orthogonal to the
    normal, with the sign of the bitangent cross(n, t); `faces` int64 [F,3] into them."""

    source: Longs
    tangents: Doubles
    faces: Longs


def derive_tangents(vertices: Doubles, normals: Doubles, uv: Doubles, faces: Longs) -> Tangents:
    """Directions of growing u: the mean over the faces at a vertex, weighted by area (Lengyel 2001).

    vertices, normals [V,3], uv [V,2] with v upwards, faces [F,3]. A vertex between faces whose texture is mirrored and
    faces whose texture is not is split. Where the texture coordinates span no area, any tangent will do.
    """
    first, second = (vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2))
    du1, dv1 = (uv[faces[:, 1]] - uv[faces[:, 0]]).T
    du2, dv2 = (uv[faces[:, 2]] - uv[faces[:, 0]]).T
    area = du1 * dv2 - du2 * dv1
    sign = np.where(area < 0, -1.0, 1.0)
    along = sign[:, None] * (first * dv2[:, None] - second * dv1[:, None])
    # In place of 1 / area in texture space, which has no bound, the area on the surface.
    length = np.linalg.norm(along, axis=1, keepdims=True)
    weight = np.linalg.norm(np.cross(first, second), axis=1, keepdims=True)
    along = np.where(length > 0, along / np.where(length > 0, length, 1) * weight, 0.0)

    mirrored = np.repeat(area < 0, 3)
    pairs, corner = np.unique(faces.ravel() * 2 + mirrored, return_inverse=True)
    source, flipped = pairs // 2, pairs % 2 == 1
    sums = np.stack([np.bincount(corner.ravel(), np.repeat(along[:, k], 3), len(pairs)) for k in range(3)], axis=1)
    normal = normals[source]
    # The axis that the normal leans to least gives a tangent where the texture gives none.
    spare = np.eye(3)[np.abs(normal).argmin(axis=1)]
    candidates = [direction - normal * (normal * direction).sum(1, keepdims=True) for direction in (sums, spare)]
    lengths = [np.linalg.norm(candidate, axis=1, keepdims=True) for candidate in candidates]
    usable = lengths[0] > 1e-9 * np.linalg.norm(sums, axis=1, keepdims=True)
    tangents = np.where(usable, candidates[0], candidates[1]) / np.where(
        usable, lengths[0], np.maximum(lengths[1], 1e-9)
    )
    handed = np.append(tangents, np.where(flipped, -1.0, 1.0)[:, None], axis=1)
    return Tangents(source, handed, corner.reshape(-1, 3))
