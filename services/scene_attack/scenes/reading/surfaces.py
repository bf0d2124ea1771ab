"""Converts a file's triangles and materials to the parts of a mesh; reads Wavefront OBJ files through trimesh.

Coordinates far from the origin lose digits, and it says so. A file in text has as many digits as its writer gave it,
and is read in 64 bits. A binary STL file, most binary PLY files and glTF hold 32-bit numbers, which are 2⁻²³ of their
size apart: vertices of a mesh 1 m wide and 2,000 km from the origin, such as one in geographical coordinates, are then
on a grid of 0.125 m, and many triangles have no area.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from scene_attack.errors import Unreadable
from scene_attack.scenes.image_file import MAX_PIXELS, to_linear
from scene_attack.scenes.mesh import Bytes, Doubles, Floats, Longs, Part, fitted
from scene_attack.scenes.reading.companion_files import CompanionFiles, decoded
from scene_attack.scenes.reading.normals import smooth_normals

FAR = 1_000.0
"""Distance from the origin, relative to the mesh's extent, beyond which rounding shows: a grid of 1e-4 of the mesh."""


def rounding_note(vertices: Doubles, declared: int, shown: int) -> str | None:
    """Returns what to say of a mesh with `declared` triangles, of which `shown` have an area; None if nothing is lost.

    vertices: finite float64 [V,3], in the file's frame. Nothing is said of coordinates that are no 32-bit numbers: they
    have more digits.
    """
    reach = float(np.abs(vertices).max())
    extent = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    if reach <= FAR * extent or not (vertices.astype(np.float32) == vertices).all():
        return None
    grid = float(np.spacing(np.float32(reach)))
    return (
        f"detail finer than {grid:.3g}: the mesh, {extent:.3g} wide, lies {reach:.3g} from the origin, and its file "
        f"holds 32-bit numbers; {declared - shown:,} of {declared:,} triangles have collapsed to nothing. Move the "
        "mesh to the origin before it is exported"
    )


MAX_TEXTURE = 1024
"""Largest side of a texture, pixels; larger textures are downscaled."""
MAX_TEXTURE_SOURCE = MAX_PIXELS
"""Maximum number of pixels of all textures of a file together, before downscaling."""
MAX_COORDINATE = 1e30
"""Largest magnitude of a file's coordinates."""
PLAIN = (204, 204, 204, 255)
"""Displayed RGBA, 0 to 255, of a surface without a stated colour: light grey."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of the same material: vertices [V,3], faces [F,3], uv [V,2] or None; color and texture as in `Part`."""

    vertices: Doubles
    faces: Longs
    uv: Floats | None
    color: Floats
    texture: Bytes | None


def read_surfaces(scene: trimesh.Scene, opacity: Mapping[str, float] | None = None) -> list[Surface]:
    """Returns all triangles of a loaded scene, with every instance transformed; points and lines are left out.

    `opacity` holds opacities by material name, which the loader does not read (MTL `d` and `Tr`). Raises Unreadable if
    vertices are not finite or beyond MAX_COORDINATE, or if a face names a vertex that is not there.
    """
    surfaces = []
    textures = Textures()
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
            continue
        # Checked before the matrix product, whose warnings about non-finite values would hide the cause.
        if not (np.isfinite(geometry.vertices).all() and np.isfinite(transform).all()):
            raise Unreadable("it has vertices that are not finite numbers")
        if max(np.abs(geometry.vertices).max(), np.abs(transform).max()) > MAX_COORDINATE:
            raise Unreadable(f"it has coordinates beyond {MAX_COORDINATE:g}")
        vertices = np.asarray(geometry.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3]
        faces = np.asarray(geometry.faces, np.int64)
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise Unreadable("a face names a vertex that is not there")
        surfaces.append(_surface(vertices, faces, geometry.visual, opacity or {}, textures))
    return surfaces


def to_parts(surfaces: Sequence[Surface], note: Callable[[str], None] = lambda _: None) -> tuple[Part, ...]:
    """Computes smooth normals over all surfaces together; returns the parts fitted to the frame, opaque parts first.

    A change of material is not a crease. Vertices must be finite. `note` is given what is not shown. Raises Unreadable
    if there are no triangles with an area.
    """
    surfaces = sorted(surfaces, key=lambda surface: bool(surface.color[3] < 1))
    offsets = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    counts = np.cumsum([0, *(len(surface.faces) for surface in surfaces)])
    if counts[-1] == 0:
        raise Unreadable("it has no triangles")
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    faces = np.concatenate([surface.faces + offset for surface, offset in zip(surfaces, offsets, strict=False)])
    used = vertices[np.unique(faces)]
    extent = float((used.max(axis=0) - used.min(axis=0)).max())
    if extent < 1 / MAX_COORDINATE:
        raise Unreadable("all its vertices are at one point: it has no area")
    # Files use any unit; in the file's own unit areas could overflow or underflow.
    at_origin = (vertices - used.mean(axis=0)) / extent

    smoothed = smooth_normals(at_origin, faces)
    if sentence := rounding_note(used, len(faces), len(smoothed.faces)):
        note(sentence)
    if not len(smoothed.faces):
        raise Unreadable("none of its triangles has an area")
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
                vertices=at_origin[source].astype(np.float32),
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
    # Where the file of a material or texture is missing, trimesh puts a grey image of its own. One from a file has a
    # format.
    pbr = isinstance(material, trimesh.visual.material.PBRMaterial)  # that of a dae file
    image: Image.Image | None = getattr(material, "baseColorTexture" if pbr else "image", None)
    if image is not None and image.format is None:
        image = None
    uv = getattr(visual, "uv", None)
    textured = uv is not None and image is not None and len(uv) == len(vertices)
    color = _factor(material) if pbr else _diffuse(material, textured, opacity)
    if image is None or not textured:
        return Surface(vertices, faces, None, color.astype(np.float32), None)
    uv = np.nan_to_num(np.asarray(uv, np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    if np.abs(uv).max(initial=0) > MAX_COORDINATE:
        raise Unreadable(f"it has texture coordinates beyond {MAX_COORDINATE:g}")
    return Surface(vertices, faces, uv, color.astype(np.float32), textures.read(image))


def _coloured(vertices: Doubles, faces: Longs, visual: Any) -> Surface:
    """Returns a surface with vertex, face or no colours. Each face's colour becomes a texel of a texture."""
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
    """Decodes each image of a file once, up to MAX_TEXTURE_SOURCE pixels in total."""

    def __init__(self) -> None:
        self._done: dict[int, tuple[Image.Image, Bytes]] = {}
        self._pixels = 0

    def read(self, image: Image.Image) -> Bytes:
        """Returns the image, uint8 [h,w,4], at most MAX_TEXTURE a side. Raises Unreadable beyond MAX_TEXTURE_SOURCE."""
        if id(image) not in self._done:
            self._pixels += image.width * image.height
            if self._pixels > MAX_TEXTURE_SOURCE:
                raise Unreadable(f"its textures have more than {MAX_TEXTURE_SOURCE:,} pixels")
            small = _eight_bits(image).convert("RGBA")
            small.thumbnail((MAX_TEXTURE, MAX_TEXTURE), Image.Resampling.BOX)
            self._done[id(image)] = image, np.array(small, dtype=np.uint8)
        return self._done[id(image)][1]


def _eight_bits(image: Image.Image) -> Image.Image:
    """Returns a grey image of 16 bits with 8. Pillow's own conversion clips it, which makes nearly all of it white; it
    reads colour images of 16 bits with 8."""
    if not image.mode.startswith("I"):
        return image
    return Image.fromarray((np.asarray(image).astype(np.float64) / 65535 * 255).round().clip(0, 255).astype(np.uint8))


def _diffuse(material: Any, textured: bool, opacity: Mapping[str, float]) -> Doubles:
    """Returns the linear RGBA of an MTL material, whose colours are displayed sRGB values."""
    stated = "kd" in material.kwargs
    rgba = np.asarray(material.diffuse if stated else PLAIN, np.float64) / 255
    color = np.append(to_linear(rgba[:3]), opacity.get(material.name, 1.0))
    if textured and (not stated or rgba[:3].max() < 0.05):
        # Exporters write no Kd, or Kd 0, with a texture that should be visible.
        color[:3] = 1.0
    return color


def _factor(material: Any) -> Doubles:
    """Returns the linear RGBA of a COLLADA material, whose colours are displayed sRGB values, as an MTL file's are."""
    rgba = np.asarray(PLAIN if material.baseColorFactor is None else material.baseColorFactor, np.float64) / 255
    return np.append(to_linear(rgba[:3]), rgba[3])


def _display_color(rgba: Any) -> Floats:
    values = np.asarray(rgba, np.float64) / 255
    return np.append(to_linear(values[:3]), values[3]).astype(np.float32)


def read_obj(files: dict[str, bytes], name: str) -> list[Surface]:
    """Returns the surfaces of the model in the file `name`; `files` holds it, its material library and its textures."""
    beside = CompanionFiles({other: data for other, data in files.items() if other != name}, "obj", files[name])
    text = BytesIO(decoded(files[name]).encode())
    scene = trimesh.load_scene(text, file_type="obj", resolver=beside, process=False)
    return read_surfaces(scene, read_opacity(beside.libraries()))


def read_opacity(mtl: str) -> dict[str, float]:
    """Returns the opacity in [0,1] of each material in an MTL file that states it: `d`, or else 1 − `Tr`."""
    opacity: dict[str, float] = {}
    dissolved: set[str] = set()
    name = ""
    for words in (line.split() for line in mtl.splitlines()):
        if len(words) < 2:
            continue
        key = words[0].lower()
        if key == "newmtl":
            name = " ".join(words[1:])
        elif key == "d" or (key == "tr" and name not in dissolved):
            try:
                value = float(words[-1])
            except ValueError:
                continue
            opacity[name] = min(max(value if key == "d" else 1 - value, 0.0), 1.0)
            if key == "d":
                dissolved.add(name)
    return opacity
