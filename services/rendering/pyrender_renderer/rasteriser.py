"""The rasteriser: images that stand in for OpenGL's while a scene is attacked, drawn by kernels/raster.cpp.

Without a GPU, OpenGL takes a microsecond for every small face that covers a sample, and shades all of it though little
is seen. The rasteriser shades what is seen only, once for all images of a pass, and draws passes side by side. Its
sampling rules are its own (kernels/coverage.h, texture.h): they define an approximation of OpenGL's image, whose error
is measured when a plan is made (errors.py). The image that is judged is OpenGL's.
"""

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, c_double, c_float, c_int64, c_void_p
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from services.rendering.kernels import compiled
from services.rendering.opengl.camera import CameraMatrices, RenderPass, n_watertight_faces, ordered

if TYPE_CHECKING:
    from services.rendering.opengl.mesh_upload import Drawing, Piece

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SAMPLES = 4
"""MSAA samples per pixel. Fixed at compile time in the kernel."""


def _fields(kind: Any, names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names.split()]


class _Texture(ctypes.Structure):
    _fields_ = (*_fields(c_int64, "levels"), *_fields(c_void_p, "texels sizes"))


class _Piece(ctypes.Structure):
    _fields_ = (
        *_fields(c_int64, "corners faces"),
        *_fields(c_void_p, "positions normals uv triangles"),
        *(("holes", c_int64), ("opacity", c_double), ("texture", _Texture)),
    )


class _Frame(ctypes.Structure):
    _fields_ = (
        *_fields(c_int64, "width height pieces"),
        ("piece", POINTER(_Piece)),
        *_fields(c_float * SAMPLES, "x y"),
        ("eye", c_float * 3),
    )


class _Pass(ctypes.Structure):
    _fields_ = (
        *_fields(c_void_p, "clip world normal order n_watertight_faces"),
        ("part", c_int64 * 4),
        *_fields(c_int64, "n_images lights"),
        *_fields(c_void_p, "ambients points colors images"),
        ("shown", c_int64),
    )


def refusal(drawing: "Drawing", lit: RenderPass) -> str | None:
    """Why the rasteriser cannot draw this scene in this light, as a clause; None where it can."""
    if compiled.library() is None:
        return "there are no compiled kernels"
    if any(piece.metallic_roughness is not None for piece in drawing.pieces):
        return "it does not know the materials of glTF files"
    if any(lit.light_counts[1:]):
        return "it knows no lights but point lights"
    return None


def draw(
    drawing: "Drawing",
    view: CameraMatrices,
    passes: Sequence[RenderPass],
    size: tuple[int, int],
    samples: Array,
    watertight: bool,
) -> list[tuple[Image, int] | None]:
    """The radiance [images, rows, columns, 4] of each pass's part, the bottom row first, and how many faces are seen.
    None for a pass in which a face reaches to the near plane or far beyond the frame.

    `size` (height, width) of the whole image; samples [4, 2], x and y in a pixel from its lower left corner;
    `watertight`: backfaces of watertight surfaces are culled. OpenGL must have drawn the drawing before: its mipmaps
    are used.
    """
    pieces = [_piece(piece) for piece in drawing.pieces]
    frame = _Frame(
        *(size[1], size[0], len(pieces), (_Piece * len(pieces))(*(piece for piece, _ in pieces))),
        *((c_float * SAMPLES)(*samples[:, axis]) for axis in (0, 1)),
        (c_float * 3)(*view.eye),
    )
    made = [_pass(drawing, view, lit, size, watertight) for lit in passes]
    work = (_Pass * len(made))(*(one for one, *_ in made))
    compiled.call("raster", torch.float32, frame, len(made), work, compiled.threads())
    return [
        (image, int(done.shown)) if done.shown >= 0 else None for done, (_, image, _) in zip(work, made, strict=True)
    ]


def _piece(piece: "Piece") -> tuple[_Piece, list[Any]]:
    """A piece for the kernel, and the arrays it points into."""
    part, levels = piece.part, [] if piece.texture is None else piece.texture.levels()
    points, normals = (np.ascontiguousarray(array, np.float32) for array in (part.vertices, part.normals))
    uv = None if piece.texture is None else np.ascontiguousarray(part.uv, np.float32)
    texels = (c_void_p * len(levels))(*(level.ctypes.data for level in levels))
    sizes = np.array([level.shape[:2] for level in levels], np.int64)
    return _Piece(
        *(len(points), len(piece.triangles), points.ctypes.data, normals.ctypes.data),
        *(None if uv is None else uv.ctypes.data, piece.triangles.ctypes.data, piece.holes, float(part.color[3])),
        _Texture(len(levels), ctypes.addressof(texels), sizes.ctypes.data),
    ), [points, normals, uv, texels, sizes, levels]


def _pass(
    drawing: "Drawing", view: CameraMatrices, lit: RenderPass, size: tuple[int, int], watertight: bool
) -> tuple[_Pass, Image, list[NDArray[Any]]]:
    """A pass for the kernel, the images it draws, and the arrays it points into."""
    top, bottom, left, right = lit.part
    count, lights = lit.points.shape[:2]
    owners = [piece.index for piece in drawing.pieces]
    matrices = view.matrices(lit.poses)
    geometry: list[NDArray[Any]]
    images = np.empty((count, bottom - top, right - left, 4), np.float32)
    colors = np.stack([piece.part.color[:3] for piece in drawing.pieces]) * lit.colors[:, owners]
    names = ("clip_from_object", "world_from_object", "normal_from_object")
    outsides = n_watertight_faces(drawing, view, lit.poses) if watertight else [0] * len(owners)
    with np.errstate(over="ignore"):  # becomes infinite, and the image is refused for it
        geometry = [np.array([matrices[owner][name] for owner in owners], np.float32) for name in names]
        order = [np.array(of, np.int64) for of in (ordered(drawing, view, lit.poses), outsides)]
        light = [np.ascontiguousarray(of, np.float32) for of in (lit.ambients, lit.points, colors)]
    return (
        _Pass(
            *(array.ctypes.data for array in (*geometry, *order)),
            (c_int64 * 4)(size[0] - bottom, size[0] - top, left, right),
            *(count, lights, *(array.ctypes.data for array in (*light, images)), -1),
        ),
        images,
        [*geometry, *order, *light],
    )
