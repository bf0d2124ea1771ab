"""Convex meshes, which cast no shadow on themselves; and closed surfaces, of which only the outside can be seen."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scene_attack.scenes.mesh import Integers, Mesh, Part

MAX_PAIRS = 2**28
"""Largest number of pairs of a face and a vertex that are checked; a mesh of more pairs counts as not convex."""
FLATNESS = 1e-5
"""Largest distance of a vertex in front of the plane of a face, as a share of the part's extent: above rounding."""
PAIRS_AT_ONCE = 2**18
"""Pairs that are checked at a time: 1 MB, which stays in the processor's cache."""


def is_convex(mesh: Mesh) -> bool:
    """Returns whether the mesh is one closed part all of whose vertices lie behind or in the plane of each face."""
    return len(mesh.parts) == 1 and _convex(_Same(mesh.parts[0]))


@dataclass(frozen=True, eq=False)
class _Same:
    """A part, equal to one with the very same arrays, whatever its surface."""

    part: Part

    def __hash__(self) -> int:
        return hash((id(self.part.vertices), id(self.part.faces)))

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, _Same)
            and self.part.vertices is other.part.vertices
            and self.part.faces is other.part.faces
        )


@lru_cache(maxsize=64)
def _convex(same: _Same) -> bool:
    vertices, numbers = np.unique(same.part.vertices, axis=0, return_inverse=True)
    if len(vertices) * len(same.part.faces) > MAX_PAIRS or not _closed(
        numbers.reshape(-1)[same.part.faces].astype(np.int32)
    ):
        return False
    a, b, c = np.moveaxis(same.part.vertices.astype(np.float64)[same.part.faces], 1, 0)
    across = np.cross(b - a, c - a)
    lengths = np.linalg.norm(across, axis=1)
    flat = lengths > 0
    normals = across[flat] / lengths[flat, None]
    limits = (normals * a[flat]).sum(1) + FLATNESS * float(np.ptp(vertices, axis=0).max())
    normals32, points = normals.astype(np.float32), np.ascontiguousarray(vertices.T, np.float32)
    step = max(1, PAIRS_AT_ONCE // len(vertices))
    return all(
        bool(((normals32[i : i + step] @ points).max(axis=1) <= limits[i : i + step]).all())
        for i in range(0, len(normals), step)
    )


def _closed(faces: Integers) -> bool:
    """Whether each edge of the faces [F, 3] belongs to exactly one other face, which has it in the other direction."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    edges = edges[edges[:, 0] != edges[:, 1]]
    count = int(faces.max(initial=0)) + 1
    ahead, back = edges @ (count, 1), edges @ (1, count)
    return len(np.unique(ahead)) == len(ahead) and np.array_equal(np.sort(ahead), np.sort(back))


OPAQUE_FROM = 128
"""Texels of less alpha are holes (see `surface.frag`); means of others are not."""


def has_holes(part: Part) -> bool:
    """Whether texels are cut out of a part."""
    return part.texture is not None and part.uv is not None and bool((part.texture[..., 3] < OPAQUE_FROM).any())


def is_opaque(part: Part) -> bool:
    """Whether nothing shows through a part. A file's glTF material has sides of its own, and counts as see-through."""
    material = part.metallic_roughness
    if material is not None:
        return material.given and material.solid
    return bool(part.color[3] >= 1) and not has_holes(part)


def outsides(mesh: Mesh) -> list[tuple[Integers, int]]:
    """Returns for each part its faces [F,3], those of watertight surfaces first, and the number of these.

    A surface is a set of faces, of any parts, connected by edges; corners at the same place count as one corner. It is
    watertight if every edge has two faces that run along it in opposite directions, and all of them are opaque. The
    faces of watertight surfaces are returned counter-clockwise seen from outside. A ray from outside then meets such a
    surface from the front first: at each sample as many of its faces look at the viewer as look away.
    """
    if not mesh.triangles:
        return [(part.faces, 0) for part in mesh.parts]
    starts = np.cumsum([0] + [len(part.vertices) for part in mesh.parts])
    points, same = np.unique(np.concatenate([p.vertices for p in mesh.parts]) + 0.0, axis=0, return_inverse=True)
    faces = same.ravel()[np.concatenate([p.faces + start for p, start in zip(mesh.parts, starts, strict=False)])]
    proper = (faces != np.roll(faces, -1, axis=1)).all(axis=1)  # the others are lines, and cover nothing
    opaque = np.concatenate([np.full(len(p.faces), is_opaque(p)) for p in mesh.parts])
    surface = np.full(len(faces), -1)
    surface[proper], whole = _surfaces(faces[proper], len(points))
    whole = np.append(whole, False)  # the last is that of the lines
    surface[~proper] = len(whole) - 1
    whole &= np.bincount(surface, ~opaque, len(whole)) == 0
    corners = points[faces].astype(np.float64)
    solid = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    inward = np.bincount(surface, solid, len(whole)) < 0  # six times the volume
    result, first = [], 0
    for part in mesh.parts:
        own = surface[first : first + len(part.faces)]
        first += len(part.faces)
        wound = np.where(inward[own][:, None], part.faces[:, [0, 2, 1]], part.faces)
        order = np.argsort(~whole[own], kind="stable")
        kept = np.where(whole[own][:, None], wound, part.faces)[order]
        result.append((np.ascontiguousarray(kept, np.int32), int(whole[own].sum())))
    return result


def _surfaces(faces: NDArray[np.int64], points: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The surface [F] that each face belongs to, and which surfaces [S] are watertight."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    owner = np.repeat(np.arange(len(faces)), 3)
    key = edges.min(axis=1) * np.int64(points) + edges.max(axis=1)
    _, edge, uses = np.unique(key, return_inverse=True, return_counts=True)
    edge = edge.ravel()
    balance = np.bincount(edge, np.sign(edges[:, 1] - edges[:, 0]), len(uses))
    order = np.argsort(edge, kind="stable")
    first = (np.cumsum(uses) - uses)[uses == 2]
    first_owner, second_owner = owner[order[first]], owner[order[first + 1]]
    links = coo_array((np.ones(len(first_owner), bool), (first_owner, second_owner)), shape=(len(faces), len(faces)))
    _, surface = connected_components(links, directed=False)
    broken = ((uses != 2) | (balance != 0))[edge]
    return surface, np.bincount(surface[owner], broken, surface.max(initial=-1) + 1) == 0
