"""A mesh of one's own as arrays, in place of a file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.bundle import Bundle

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


class MeshArrays(str):
    """A mesh's name in a request, `sha256:` and 64 digits, which has the mesh with it as the bytes of a file.

    vertices: finite numbers [V, 3], +y up, of any scale: an object is centred and scaled to fit the frame. faces: their
    numbers from 0, [F, 3], counter-clockwise seen from outside. The surface is the object's colour and material; a mesh
    with textures is given by the path of its file. Raises InvalidRequest("vertices" or "faces").
    """

    __slots__ = ("bundle",)
    bundle: Bundle

    def __new__(cls, vertices: ArrayLike, faces: ArrayLike) -> Self:
        """Checks the arrays and names what they are."""
        bundle = Bundle("ply", _ply(*_checked(vertices, faces)), {})
        made = super().__new__(cls, f"sha256:{bundle.sha256}")
        made.bundle = bundle
        return made

    def __copy__(self) -> Self:
        """Returns the mesh itself, which does not change."""
        return self

    def __deepcopy__(self, _: dict[int, Any]) -> Self:
        return self


def _checked(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    import numpy as np

    points, corners = np.asarray(vertices), np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise InvalidRequest("vertices", f"must be numbers [V, 3], not {points.dtype} {list(points.shape)}")
    if not np.isfinite(points).all():
        raise InvalidRequest("vertices", "must be finite numbers, and some are not")
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu" or not len(corners):
        raise InvalidRequest(
            "faces",
            f"must be the whole numbers of three vertices each, [F, 3], not {corners.dtype} {list(corners.shape)}",
        )
    low, high = int(corners.min()), int(corners.max())
    if low < 0 or high >= len(points):
        wrong = low if low < 0 else high
        raise InvalidRequest("faces", f"must be numbers of vertices from 0 to {len(points) - 1}, not {wrong}")
    return points.astype("<f4"), corners.astype("<i4")


def _ply(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> bytes:
    """The bytes of a binary PLY file."""
    import numpy as np

    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return "\n".join(header).encode() + vertices.tobytes() + rows.tobytes()
