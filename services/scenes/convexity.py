"""Finds out whether a mesh is convex: such an object casts no shadow on itself."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from services.scenes.mesh import Integers, Mesh, Part

MAX_PAIRS = 2**28
"""Most pairs of a face and a vertex that are looked at; a mesh of more of them counts as not convex."""
FLATNESS = 1e-5
"""How far a vertex may be before the plane of a face, as a share of the part's extent: more than rounding."""
AT_ONCE = 2**18
"""Pairs that are looked at at once: 1 MB, which stays in the processor's cache."""


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
    step = max(1, AT_ONCE // len(vertices))
    return all(
        bool(((normals32[i : i + step] @ points).max(axis=1) <= limits[i : i + step]).all())
        for i in range(0, len(normals), step)
    )


def _closed(faces: Integers) -> bool:
    """Whether each edge of the faces [F, 3] is that of one other face, which runs through it the other way."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    edges = edges[edges[:, 0] != edges[:, 1]]
    count = int(faces.max(initial=0)) + 1
    ahead, back = edges @ (count, 1), edges @ (1, count)
    return len(np.unique(ahead)) == len(ahead) and np.array_equal(np.sort(ahead), np.sort(back))
