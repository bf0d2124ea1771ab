"""Smooth vertex normals with a crease angle, for unwelded meshes with duplicate or flipped faces; tangents from
textures.
"""

from dataclasses import dataclass
from math import cos, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from scene_attack.scenes.mesh import Doubles, Longs

CREASE_ANGLE = 40 * pi / 180
"""Default crease angle, radians: faces that meet at a smaller angle are shaded as a smooth surface."""
WELD = 1e-5
"""Welding distance as a fraction of the mesh's diagonal: closer vertices count as the same point for shading."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A mesh whose vertices are split where shading is not smooth.

    source: int64 [V], the index of the input vertex that each vertex copies. normals: float64 [V,3], unit. faces: int64
    [F,3], indices of these vertices, with consistent winding. kept: int64 [F], the index of each face in the input.
    """

    source: Longs
    normals: Doubles
    faces: Longs
    kept: Longs


def smooth_normals(vertices: Doubles, faces: Longs, crease: float = CREASE_ANGLE) -> Smoothed:
    """Computes unit vertex normals: means of the face normals around a vertex, weighted by the faces' angles there.

    vertices is finite [V,3], faces [F,3]. Two faces are averaged at a vertex if a path around it connects them over
    edges where faces meet at less than `crease` radians. Coincident vertices count as the same vertex for this, so that
    texture seams and unshared vertices do not show; the vertices themselves are not merged. Degenerate and duplicate
    faces are dropped. Faces wound against their neighbours are flipped; the winding of most of a component's area is
    kept. Angle weights (Thürmer and Wüthrich 1998) do not depend on the triangulation of a polygon.
    """
    points = weld(vertices)
    kept = usable_faces(vertices, faces, points)
    faces = faces[kept].copy()
    if not len(faces):
        return Smoothed(np.zeros(0, np.int64), np.zeros((0, 3)), faces, kept)
    corners = points[faces]
    cross = _cross(vertices, faces)
    lengths = np.linalg.norm(cross, axis=1)
    first, second, opposed, manifold = _neighbours(corners)

    sign = orientation(len(faces), first[manifold], second[manifold], opposed[manifold], lengths)
    unit = sign[:, None] * cross / lengths[:, None]
    smooth = np.einsum("ij,ij->i", unit[first], unit[second]) > cos(crease)

    groups = _groups(corners, first[smooth], second[smooth])
    weighted = _angles(vertices, faces)[:, :, None] * unit[:, None, :]
    sums = np.zeros((groups.max() + 1, 3))
    for axis in range(3):
        sums[:, axis] = np.bincount(groups.ravel(), weighted[:, :, axis].ravel(), minlength=len(sums))
    norms = np.linalg.norm(sums, axis=1)

    # An output vertex per pair of input vertex and smooth fan: seams of the input stay, and creases are split.
    pairs, new = np.unique(faces.ravel() * np.int64(len(sums)) + groups.ravel(), return_inverse=True)
    source, group = np.divmod(pairs, len(sums))
    normals = sums[group] / np.maximum(norms[group], 1e-300)[:, None]
    # The normals of a fan may cancel (a folded sliver); then the normal of any of its faces is used.
    fallback = np.zeros(len(pairs), np.int64)
    fallback[new] = np.repeat(np.arange(len(faces)), 3)
    normals = np.where((norms[group] < 1e-9)[:, None], unit[fallback], normals)

    out = new.reshape(-1, 3)
    out[sign < 0] = out[sign < 0][:, ::-1]
    return Smoothed(source, normals, out, kept)


def weld(vertices: Doubles) -> Longs:
    """The number int64 [V] of the point that each of the `vertices` [V,3] belongs to.

    Vertices in one cell of a grid share a point; its cells are `WELD` times the mesh's diagonal.
    """
    if not len(vertices):
        return np.zeros(0, np.int64)
    low = vertices.min(axis=0)
    cell = max(float(np.linalg.norm(vertices.max(axis=0) - low)) * WELD, 1e-300)
    grid = np.rint((vertices - low) / cell).astype(np.int64)
    side = int(2 / WELD) + 2
    key = (grid[:, 0] * side + grid[:, 1]) * side + grid[:, 2]
    return np.unique(key, return_inverse=True)[1]


def _cross(vertices: Doubles, faces: Longs) -> Doubles:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def usable_faces(vertices: Doubles, faces: Longs, points: Longs) -> Longs:
    """Indices int64 of the `faces` [F,3] that have an area; of faces with the same three points the first alone.

    `points` int64 [V] is the point of each vertex, as `weld` numbers them.
    """
    corners = np.sort(points[faces], axis=1)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    longest = np.maximum(np.maximum(((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1)), ((a - c) ** 2).sum(1))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    # Below this height-to-length ratio a normal from float32 coordinates is noise.
    proper = np.flatnonzero(
        (area > 1e-6 * longest) & (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    )
    _, once = np.unique(corners[proper], axis=0, return_index=True)
    return proper[np.sort(once)]


def _neighbours(corners: Longs) -> tuple[Longs, Longs, NDArray[np.bool_], NDArray[np.bool_]]:
    """Returns the pairs of faces that share an edge, as four arrays: first, second, opposed, manifold.

    opposed: the faces traverse the edge in opposite directions, as on a consistently wound surface. manifold: the edge
    has only these two faces. Of up to four faces at an edge all pairs are returned; of more, only pairs close in order.
    """
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(corners)), 3)
    key = np.minimum(start, end) * np.int64(corners.max() + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    key, face, forward = key[order], face[order], (start < end)[order]
    _, which, count = np.unique(key, return_inverse=True, return_counts=True)
    pairs = [(here := np.flatnonzero(key[step:] == key[:-step]), here + step) for step in (1, 2, 3) if len(key) > step]
    i = np.concatenate([pair[0] for pair in pairs])
    j = np.concatenate([pair[1] for pair in pairs])
    return face[i], face[j], forward[i] != forward[j], count[which[i]] == 2


def orientation(n: int, first: Longs, second: Longs, opposed: NDArray[np.bool_], areas: Doubles) -> Doubles:
    """+1.0 or -1.0 [n] for each face, so that neighbours are wound alike; most of a connected area keeps its winding.

    `first` and `second` [pairs] are faces that share an edge, `opposed` [pairs] whether they run along it in opposite
    directions, and `areas` [n] the faces' areas up to a factor.
    """
    graph = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(n, n)).tocsr()
    _, component = connected_components(graph, directed=False)
    _, roots = np.unique(component, return_index=True)
    # A virtual face n, adjacent to a face of every component, joins all components into a tree.
    rows = np.concatenate([first, roots])
    columns = np.concatenate([second, np.full(len(roots), n)])
    joined = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(n + 1, n + 1)).tocsr()
    _, parent = breadth_first_order(joined, n, directed=False)
    parent = parent.astype(np.int64)
    parent[n] = n

    lookup = np.concatenate([first * np.int64(n) + second, second * np.int64(n) + first])
    relation = np.tile(np.where(opposed, 1.0, -1.0), 2)
    order = np.argsort(lookup, kind="stable")
    lookup, relation = lookup[order], relation[order]
    sign = np.ones(n + 1)
    child = np.flatnonzero(parent[:n] != n)
    sign[child] = relation[np.searchsorted(lookup, child * np.int64(n) + parent[child])]
    # Multiply along the path to the root by doubling: after k rounds each face knows its 2^k nearest ancestors.
    while not (parent == n).all():
        sign = sign * sign[parent]
        parent = parent[parent]
    sign = sign[:n]
    majority = np.bincount(component, sign * areas)
    turned: Doubles = sign * np.where(majority < 0, -1.0, 1.0)[component]
    return turned


def _angles(vertices: Doubles, faces: Longs) -> Doubles:
    """Returns the three inner angles of each face, [F,3], radians."""
    corners = vertices[faces]
    after, before = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(after, before), axis=2)
    angles: Doubles = np.arctan2(sine, (after * before).sum(axis=2))
    return angles


def _groups(corners: Longs, first: Longs, second: Longs) -> Longs:
    """Returns a group index for each corner, [F,3]; corners at a point share it if smooth edges connect their faces."""
    rows, columns = [], []
    for k in range(3):
        for m in range(3):
            # Faces that share an edge share its two points, so their corners there join the same group.
            same = corners[first, k] == corners[second, m]
            rows.append(first[same] * 3 + k)
            columns.append(second[same] * 3 + m)
    i, j = np.concatenate(rows), np.concatenate(columns)
    graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(corners.size, corners.size)).tocsr()
    labels: Longs = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels.reshape(corners.shape)


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
