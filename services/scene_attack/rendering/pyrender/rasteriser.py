"""The rasteriser: images that stand in for OpenGL's while a scene is attacked, drawn by kernels/raster.cpp.

Without a GPU, OpenGL takes a microsecond for every small face that covers a sample, and shades all of it though little
is seen. The rasteriser shades what is seen only, once for all images of a pass, and draws passes side by side. Its
sampling rules are its own (kernels/coverage.h, texture.h): they define an approximation of OpenGL's image, whose error
is measured when a plan is made (planner.py). The image that is judged is OpenGL's.
"""

import ctypes
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from scene_attack.rendering.kernels import compiled, levels
from scene_attack.rendering.opengl.camera import RenderPass, n_watertight_faces, ordered
from scene_attack.scenes.view import clipped

if TYPE_CHECKING:
    from scene_attack.rendering.opengl.mesh_upload import Drawing, Piece

Image = NDArray[np.float32]

SAMPLES = 4
"""MSAA samples per pixel. Fixed at compile time in the kernel."""
GUARD = 1.5
"""Size of the drawn part of a floor relative to the frame. Above 1, so that its edges are never visible."""


def refusal(drawing: "Drawing", lit: RenderPass) -> str | None:
    """Returns the reason why the rasteriser cannot draw this scene in this light, as a clause; None if it can."""
    if compiled.library() is None:
        return f"there are no compiled kernels ({levels.why_none()})"
    materials = [piece.metallic_roughness for piece in drawing.pieces]
    if any(material is not None and not material.given for material in materials):
        return "it does not know the materials of glTF files"
    if any(material is not None and not material.plain for material in materials):
        return "of surfaces whose metallic and roughness are given, it knows opaque ones without textures only"
    if lit.shadows is not None:
        return "it draws no shadows"
    if any(lit.light_counts[1:]):
        return "it knows no lights but point lights"
    return None


def draw(
    drawing: "Drawing",
    passes: Sequence[RenderPass],
    size: tuple[int, int],
    samples: NDArray[np.float64],
    watertight: bool,
    floor: bool = False,
) -> list[tuple[Image, int] | None]:
    """Returns the radiance [images, rows, columns, 4] of each pass's part, the bottom row first, and the number of
    faces that are seen; None for a pass in which a face reaches to the near plane or far beyond the frame, or is seen
    from its edge.

    `size` (height, width) of the whole image; samples [4, 2], x and y in a pixel from its lower left corner;
    `watertight`: backfaces of watertight surfaces are culled. `floor`: the last piece is a scene's floor, which is
    clipped to what the camera sees of it, since it may reach to the camera and far beyond the frame. OpenGL must have
    drawn the drawing before: its mipmaps are used.
    """
    if floor and passes and any((lit.view.clip_from_world != passes[0].view.clip_from_world).any() for lit in passes):
        return [result for lit in passes for result in draw(drawing, [lit], size, samples, watertight, floor)]
    pieces = [_piece(piece) for piece in drawing.pieces]
    if floor and passes:
        pieces[-1] = _piece(_clipped(drawing.pieces[-1], passes[0].view.clip_from_world))
    sizes = {"height": size[0], "width": size[1], "pieces": len(pieces)}
    frame = compiled.structure("Frame", piece=pieces, x=samples[:, 0], y=samples[:, 1], **sizes)
    prepared = [_pass(drawing, lit, size[0], watertight) for lit in passes]
    n_seen = np.empty(len(prepared), np.int64)
    compiled.call(
        "raster",
        torch.float32,
        frame,
        len(prepared),
        [structure for structure, _ in prepared],
        n_seen,
        compiled.threads(),
    )
    return [(images, int(faces)) if faces >= 0 else None for (_, images), faces in zip(prepared, n_seen, strict=True)]


def _piece(piece: "Piece") -> ctypes.Structure:
    part, levels = piece.part, [] if piece.texture is None else piece.texture.levels()
    material = piece.metallic_roughness
    sizes = np.array([level.shape[:2] for level in levels], np.int64)
    return compiled.structure(
        "Piece",
        corners=len(part.vertices),
        faces=len(piece.triangles),
        positions=np.ascontiguousarray(part.vertices, np.float32),
        normals=np.ascontiguousarray(part.normals, np.float32),
        uv=None if piece.texture is None else np.ascontiguousarray(part.uv, np.float32),
        triangles=piece.triangles,
        holes=piece.holes,
        opacity=float(part.color[3]),
        metallic=-1.0 if material is None else material.metallic,
        roughness=0.0 if material is None else material.roughness,
        texture=compiled.structure("Texture", levels=len(levels), texels=levels, sizes=sizes),
    )


def _clipped(piece: "Piece", clip_from_world: NDArray[np.float64]) -> "Piece":
    """Returns the part of a flat convex piece, in world space, that is within GUARD times the frame, as a fan."""
    part = piece.part
    outline = np.append(part.vertices.astype(np.float64), np.ones((len(part.vertices), 1)), axis=1)
    to_clip = np.diag([1 / GUARD, 1 / GUARD, 1.0, 1.0]) @ clip_from_world
    seen = np.linalg.solve(to_clip, clipped(outline @ to_clip.T).T).T
    faces = np.array([(0, k, k + 1) for k in range(1, len(seen) - 1)], np.int32).reshape(-1, 3)
    vertices = (seen[:, :3] / seen[:, 3:]).astype(np.float32)
    normals = np.tile(part.normals[0], (len(seen), 1))
    return replace(piece, part=replace(part, vertices=vertices, normals=normals), triangles=faces)


def _pass(drawing: "Drawing", lit: RenderPass, height: int, watertight: bool) -> tuple[ctypes.Structure, Image]:
    """A pass for the kernel, and the images it draws."""
    view = lit.view
    top, bottom, left, right = lit.part
    images = np.zeros((len(lit.points), bottom - top, right - left, 4), np.float32)
    owners = [piece.index for piece in drawing.pieces]
    matrices = view.matrices(lit.poses)
    outsides = n_watertight_faces(drawing, view, lit.poses) if watertight else [0] * len(owners)
    floats = {"ambients": lit.ambients, "points": lit.points}
    floats["colors"] = np.stack([piece.part.color[:3] for piece in drawing.pieces]) * lit.colors[:, owners]
    for name in ("clip", "world", "normal"):
        floats[name] = np.array([matrices[owner][f"{name}_from_object"] for owner in owners])
    with np.errstate(over="ignore"):  # becomes infinite, and the image is refused for it
        return compiled.structure(
            "Pass",
            eye=view.eye,
            part=(height - bottom, height - top, left, right),
            order=np.array(ordered(drawing, view, lit.poses), np.int64),
            n_watertight_faces=np.array(outsides, np.int64),
            n_images=len(lit.points),
            lights=lit.points.shape[1],
            images=images,
            **{name: np.ascontiguousarray(array, np.float32) for name, array in floats.items()},
        ), images
