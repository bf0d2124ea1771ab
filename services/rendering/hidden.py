"""Faces that others hide: of a furniture model as it is found most are inside it, or smaller than what is sampled.

A face is left out of a pass only if, however a rasteriser rounds, it covers no sample or is behind all that shows in
the blocks of 2 × 2 pixels it covers (loops/hidden.cpp), so that the picture has the same bits. That is found anew for
every pose. It pays where a processor draws, for which a face is a microsecond.
"""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from services.rendering import native
from services.rendering.extent import Rectangle

if TYPE_CHECKING:
    from services.rendering.geometry import Drawing

SAMPLES = 4
"""Of a pixel, that the loop is written for."""
WORTH = 0.5
"""Looking for hidden faces pays if no more than this share of them is left to draw."""


class _Piece(ctypes.Structure):
    _fields_ = (
        ("corners", ctypes.c_int64),
        ("faces", ctypes.c_int64),
        ("positions", ctypes.c_void_p),
        ("triangles", ctypes.c_void_p),
        ("opaque", ctypes.c_int64),
    )


class _Frame(ctypes.Structure):
    _fields_ = (
        ("width", ctypes.c_int64),
        ("height", ctypes.c_int64),
        ("x", ctypes.c_double * SAMPLES),
        ("y", ctypes.c_double * SAMPLES),
    )


@dataclass(frozen=True)
class Faces:
    """What is to be drawn of a drawing's pieces: `triangles` int32 [N, 3], piece after piece, and in each those of
    closed surfaces before the others; `counts` int64 [pieces, 2] of both."""

    triangles: NDArray[np.int32]
    counts: NDArray[np.int64]


def available() -> bool:
    """Whether the loop can be had: there is none in torch."""
    return native.library() is not None


def seen(
    drawing: "Drawing",
    clip_from_object: NDArray[np.float64],
    closed: NDArray[np.int64],
    parts: Sequence[Rectangle],
    size: tuple[int, int],
    samples: NDArray[np.float64],
) -> list[Faces]:
    """For each pass the faces that may be seen in it.

    clip_from_object [passes, pieces, 4, 4]; closed [passes, pieces], of each piece's faces the first so many, of which
    only the side that is counter-clockwise is drawn; parts, where in a picture of `size` (height, width) the objects
    are; samples [4, 2], x and y in a pixel from its lower left corner.
    """
    pieces = drawing.pieces
    arrays = [(np.ascontiguousarray(piece.part.vertices, np.float32), piece.triangles) for piece in pieces]
    table = (_Piece * len(pieces))(
        *(
            _Piece(len(points), len(faces), points.ctypes.data, faces.ctypes.data, piece.solid and not piece.holes)
            for piece, (points, faces) in zip(pieces, arrays, strict=True)
        )
    )
    frame = _Frame(
        size[1], size[0], (ctypes.c_double * SAMPLES)(*samples[:, 0]), (ctypes.c_double * SAMPLES)(*samples[:, 1])
    )
    total = sum(piece.faces for piece in pieces)
    # rows from the bottom, as OpenGL counts them
    rows = np.array([(size[0] - bottom, size[0] - top, left, right) for top, bottom, left, right in parts], np.int64)
    kept = np.empty((len(parts), total, 3), np.int32)
    counts = np.empty((len(parts), len(pieces), 2), np.int64)
    matrices = np.ascontiguousarray(clip_from_object, np.float32)
    tensors = [
        torch.from_numpy(array) for array in (matrices, np.ascontiguousarray(closed, np.int64), rows, kept, counts)
    ]
    native.call("seen", torch.float32, len(parts), len(pieces), total, table, frame, *tensors, native.threads())
    return [Faces(faces[: int(count.sum())], count) for faces, count in zip(kept, counts, strict=True)]
