"""Pictures with the bits that the software driver (llvmpipe) gives them, from loops of our own (loops/raster.cpp).

On a processor the driver takes a microsecond for every small face that covers a sample, and shades all of it though
little shows. The loops do its arithmetic in its order, but shade only what shows, once for all pictures of a pass, and
draw passes side by side (docs/benchmarks.md has the times). They know one driver's arithmetic; whoever uses them
compares a picture first (`PyrenderRenderer`), and lets OpenGL draw where a bit differs.
"""

import ctypes
from collections.abc import Sequence
from ctypes import c_double, c_int64, c_void_p
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from services.rendering.kernels import compiled
from services.rendering.opengl.camera import CameraMatrices, RenderPass, closed_faces, ordered

if TYPE_CHECKING:
    from services.rendering.opengl.mesh_upload import Drawing, Piece

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SAMPLES = 4
"""Of a pixel, in pictures of the pyrender renderer; the loops are written for as many."""


class _Texture(ctypes.Structure):
    _fields_ = (("levels", c_int64), ("texels", c_void_p), ("sizes", c_void_p))


class _Piece(ctypes.Structure):
    _fields_ = (
        *((name, c_int64) for name in ("corners", "faces")),
        *((name, c_void_p) for name in ("positions", "normals", "uv", "triangles")),
        *((name, c_int64) for name in ("holes", "blended")),
        ("opacity", c_double),
        ("texture", _Texture),
    )


class _Frame(ctypes.Structure):
    _fields_ = (
        *((name, c_int64) for name in ("width", "height", "pieces")),
        ("piece", ctypes.POINTER(_Piece)),
        ("x", c_double * SAMPLES),
        ("y", c_double * SAMPLES),
        ("eye", c_double * 3),
    )


class _Pass(ctypes.Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("clip", "world", "normal", "order", "closed")),
        ("part", c_int64 * 4),
        *((name, c_int64) for name in ("pictures", "lights")),
        *((name, c_void_p) for name in ("ambients", "points", "colors", "images")),
        *((name, c_int64) for name in ("drawn", "shown")),
    )


def available() -> bool:
    """Whether the loops can be had: there are none in torch."""
    return compiled.library() is not None


def draw(
    drawing: "Drawing",
    view: CameraMatrices,
    passes: Sequence[RenderPass],
    size: tuple[int, int],
    samples: Array,
    closed: bool,
) -> list[tuple[Image, int] | None]:
    """Of each pass the radiance [pictures, rows, columns, 4] of its part, the bottom row first, and how many faces
    show; None where something is cut by the frame or the near plane, and the driver would draw other faces, and for
    glTF materials and lights other than point lights.

    `size` (height, width) of the whole picture; samples [4, 2], x and y in a pixel from its lower left corner;
    `closed`: of closed surfaces only the outside is drawn. OpenGL must have drawn the drawing before: its textures are
    asked back.
    """
    if any(piece.metallic_roughness is not None for piece in drawing.pieces) or any(
        any(lit.light_counts[1:]) for lit in passes
    ):
        return [None] * len(passes)  # it knows neither glTF materials nor directional and spot lights
    pieces = [_of_piece(piece) for piece in drawing.pieces]
    table = (_Piece * len(pieces))(*(piece for piece, _ in pieces))
    frame = _Frame(
        size[1],
        size[0],
        len(pieces),
        table,
        (c_double * SAMPLES)(*samples[:, 0]),
        (c_double * SAMPLES)(*samples[:, 1]),
        (c_double * 3)(*view.eye.astype(np.float32)),
    )
    made = [_of_pass(drawing, view, lit, size, closed) for lit in passes]
    work = (_Pass * len(made))(*(one for one, *_ in made))
    compiled.call("raster", torch.float32, frame, len(made), work, compiled.threads())
    return [(image, int(done.shown)) if done.drawn else None for done, (_, image, _) in zip(work, made, strict=True)]


def _of_piece(piece: "Piece") -> tuple[_Piece, list[Any]]:
    """A piece for the loops, and the arrays it points into."""
    part, levels = piece.part, [] if piece.texture is None else piece.texture.levels()
    points, normals = (np.ascontiguousarray(array, np.float32) for array in (part.vertices, part.normals))
    uv = None if piece.texture is None else np.ascontiguousarray(part.uv, np.float32)
    texels = (c_void_p * len(levels))(*(level.ctypes.data for level in levels))
    sizes = np.array([level.shape[:2] for level in levels], np.int64)
    return (
        _Piece(
            len(points),
            len(piece.triangles),
            points.ctypes.data,
            normals.ctypes.data,
            None if uv is None else uv.ctypes.data,
            piece.triangles.ctypes.data,
            piece.holes,
            not piece.solid,
            float(part.color[3]),
            _Texture(len(levels), ctypes.addressof(texels), sizes.ctypes.data),
        ),
        [points, normals, uv, texels, sizes, levels],
    )


def _of_pass(
    drawing: "Drawing", view: CameraMatrices, lit: RenderPass, size: tuple[int, int], closed: bool
) -> tuple[_Pass, Image, list[NDArray[Any]]]:
    """A pass for the loops, the images it draws, and the arrays it points into."""
    top, bottom, left, right = lit.part
    count, lights = lit.points.shape[:2]
    owners = [piece.index for piece in drawing.pieces]
    of_objects = view.matrices(lit.poses)
    images = np.empty((count, bottom - top, right - left, 4), np.float32)
    base = np.stack([piece.part.color[:3] for piece in drawing.pieces])
    arrays: list[NDArray[Any]] = [
        *(
            np.array([of_objects[owner][name] for owner in owners], np.float32)
            for name in ("clip_from_object", "world_from_object", "normal_from_object")
        ),
        np.array(ordered(drawing, view, lit.poses), np.int64),
        np.array(closed_faces(drawing, view, lit.poses) if closed else [0] * len(owners), np.int64),
    ]
    with np.errstate(over="ignore"):  # becomes infinite, and the picture is refused for it
        of_pictures: list[NDArray[Any]] = [
            np.ascontiguousarray(array, np.float32)
            for array in (lit.ambients, lit.points, base * lit.colors[:, owners])
        ]
    return (
        _Pass(
            *(array.ctypes.data for array in arrays),
            (c_int64 * 4)(size[0] - bottom, size[0] - top, left, right),
            count,
            lights,
            *(array.ctypes.data for array in (*of_pictures, images)),
            0,
            0,
        ),
        images,
        [*arrays, *of_pictures],
    )
