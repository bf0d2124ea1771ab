"""From triangles with a material, as a file has them, to the parts of a mesh."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from services.scenes.mesh import Bytes, Doubles, Floats, Longs, Part, fitted
from services.scenes.normals import CREASE_ANGLE, smooth_normals
from services.scenes.srgb import to_linear

MAX_TEXTURE = 1024
"""Textures are reduced to this many pixels a side; a frame has no more."""
MAX_TEXTURE_SOURCE = 2**26
"""Pixels of all textures of a file together; more are not decoded."""
MAX_COORDINATE = 1e30
PLAIN = (204, 204, 204, 255)
"""Colour of a surface whose material says nothing: a light grey, as displayed."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of one material: vertices [V,3], faces [F,3], uv [V,2] or None; color and texture as in `Part`."""

    vertices: Doubles
    faces: Longs
    uv: Floats | None
    color: Floats
    texture: Bytes | None


def read_surfaces(scene: trimesh.Scene, opacity: Mapping[str, float] | None = None) -> list[Surface]:
    """All triangles of a loaded scene, every instance in its place; points and lines are left out.

    `opacity`: by material name, where the loader does not read it (MTL `d` and `Tr`). Raises ValueError if vertices are
    not finite or beyond MAX_COORDINATE, or if a face names a vertex that is not there.
    """
    surfaces = []
    textures = Textures()
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
            continue
        # Checked before they meet a matrix: warnings of non-finite products would hide what is wrong.
        if not (np.isfinite(geometry.vertices).all() and np.isfinite(transform).all()):
            raise ValueError("it has vertices that are not finite numbers")
        if max(np.abs(geometry.vertices).max(), np.abs(transform).max()) > MAX_COORDINATE:
            raise ValueError(f"it has coordinates beyond {MAX_COORDINATE:g}")
        vertices = np.asarray(geometry.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3]
        faces = np.asarray(geometry.faces, np.int64)
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError("a face names a vertex that is not there")
        surfaces.append(_surface(vertices, faces, geometry.visual, opacity or {}, textures))
    return surfaces


def to_parts(surfaces: Sequence[Surface], crease: float = CREASE_ANGLE) -> tuple[Part, ...]:
    """Smooth normals over all surfaces together (a change of material is not a crease), then fitted to the frame.

    Opaque parts come first. Vertices must be finite. Raises ValueError if there are no triangles with an area.
    """
    surfaces = sorted(surfaces, key=lambda surface: bool(surface.color[3] < 1))
    offsets = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    counts = np.cumsum([0, *(len(surface.faces) for surface in surfaces)])
    if counts[-1] == 0:
        raise ValueError("it has no triangles")
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    faces = np.concatenate([surface.faces + offset for surface, offset in zip(surfaces, offsets, strict=False)])
    used = vertices[np.unique(faces)]
    extent = float((used.max(axis=0) - used.min(axis=0)).max())
    if extent < 1 / MAX_COORDINATE:
        raise ValueError("all its vertices are at one point: it has no area")
    # Files come in every unit; in their own, areas could over- or underflow.
    vertices = (vertices - used.mean(axis=0)) / extent

    smoothed = smooth_normals(vertices, faces, crease)
    if not len(smoothed.faces):
        raise ValueError("none of its triangles has an area")
    parts = []
    for k, surface in enumerate(surfaces):
        mine = smoothed.faces[(smoothed.kept >= counts[k]) & (smoothed.kept < counts[k + 1])]
        if not len(mine):
            continue
        index, local = np.unique(mine, return_inverse=True)
        source = smoothed.source[index]
        uv = None if surface.uv is None else surface.uv[source - offsets[k]]
        parts.append(
            Part(
                vertices=vertices[source].astype(np.float32),
                normals=smoothed.normals[index].astype(np.float32),
                faces=local.reshape(-1, 3).astype(np.int32),
                uv=uv,
                color=surface.color,
                texture=surface.texture if uv is not None else None,
            )
        )
    return fitted(tuple(parts))


def _surface(
    vertices: Doubles, faces: Longs, visual: Any, opacity: Mapping[str, float], textures: "Textures"
) -> Surface:
    material = getattr(visual, "material", None)
    if material is None:
        return _coloured(vertices, faces, visual)
    image = material.image
    uv = getattr(visual, "uv", None)
    textured = uv is not None and image is not None and len(uv) == len(vertices)
    color = _diffuse(material, textured, opacity)
    if not textured:
        return Surface(vertices, faces, None, color.astype(np.float32), None)
    uv = np.nan_to_num(np.asarray(uv, np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return Surface(vertices, faces, uv, color.astype(np.float32), textures.read(image))


def _coloured(vertices: Doubles, faces: Longs, visual: Any) -> Surface:
    """A surface with vertex or face colours or none: one colour a face, held in a texture with one texel a colour."""
    if getattr(visual, "kind", None) not in ("vertex", "face"):
        return Surface(vertices, faces, None, _display_color(PLAIN), None)
    palette, index = np.unique(np.asarray(visual.face_colors, np.uint8), axis=0, return_inverse=True)
    if len(palette) == 1:
        return Surface(vertices, faces, None, _display_color(palette[0]), None)
    side = int(np.ceil(np.sqrt(len(palette))))
    texture = np.zeros((side, side, 4), np.uint8)
    texture.reshape(-1, 4)[: len(palette)] = palette
    row, column = np.divmod(np.repeat(index.ravel(), 3), side)
    uv = np.stack([(column + 0.5) / side, 1 - (row + 0.5) / side], axis=1).astype(np.float32)
    apart = vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)
    return Surface(*apart, uv, np.ones(4, np.float32), texture)


class Textures:
    """Decodes each image of a file once, and not more than MAX_TEXTURE_SOURCE pixels of them."""

    def __init__(self) -> None:
        self._done: dict[int, tuple[Image.Image, Bytes]] = {}
        self._pixels = 0

    def read(self, image: Image.Image) -> Bytes:
        """The image as uint8 [h,w,4], at most MAX_TEXTURE a side. Raises ValueError where there is too much."""
        if id(image) not in self._done:
            self._pixels += image.width * image.height
            if self._pixels > MAX_TEXTURE_SOURCE:
                raise ValueError(f"its textures have more than {MAX_TEXTURE_SOURCE:,} pixels")
            small = image.convert("RGBA")
            small.thumbnail((MAX_TEXTURE, MAX_TEXTURE), Image.Resampling.BOX)
            self._done[id(image)] = image, np.array(small, dtype=np.uint8)
        return self._done[id(image)][1]


def _diffuse(material: Any, textured: bool, opacity: Mapping[str, float]) -> Doubles:
    """Linear RGBA of an MTL material, whose colours are meant for the screen."""
    stated = "kd" in material.kwargs
    rgba = np.asarray(material.diffuse if stated else PLAIN, np.float64) / 255
    color = np.append(to_linear(rgba[:3]), opacity.get(material.name, 1.0))
    if textured and (not stated or rgba[:3].max() < 0.05):
        # Exporters write no Kd, or Kd 0, under a texture that is meant to be seen.
        color[:3] = 1.0
    return color


def _display_color(rgba: Any) -> Floats:
    values = np.asarray(rgba, np.float64) / 255
    return np.append(to_linear(values[:3]), values[3]).astype(np.float32)
