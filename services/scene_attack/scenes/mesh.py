"""Defines the mesh that renderers take: parts with a surface each, upright, centred and scaled to fit the frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import sin
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scene_attack.errors import Unreadable
from scene_attack.scenes.description import DISTANCE, FIELD_OF_VIEW

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Integers = NDArray[np.int32]
Longs = NDArray[np.int64]
Bytes = NDArray[np.uint8]

FIT_RADIUS = 0.9 * DISTANCE * sin(FIELD_OF_VIEW / 2)
"""Bounding-sphere radius of a fitted mesh, scene units: it fills 90 % of the frame's height at the paper's distance."""


AlphaMode = Literal["OPAQUE", "MASK", "BLEND"]
MapName = Literal["base_color", "metallic_roughness", "normal", "occlusion", "emissive"]


@dataclass(frozen=True, eq=False)
class TextureMap:
    """An image on a surface.

    texels: uint8 [h,w,4], row 0 at the top; base colours and emission are sRGB, the other maps linear. uv_set: 0 for
    `Part.uv`, 1 for `MetallicRoughness.second_uv`. wrap: OpenGL's wrap modes for u and v, which are also glTF's.
    """

    texels: Bytes
    uv_set: int
    wrap: tuple[int, int]


@dataclass(frozen=True, eq=False)
class MaterialSettings:
    """The settings of a glTF 2.0 metallic-roughness material, but for its base colour factor.

    metallic, roughness, alpha_cutoff, occlusion_strength: in [0,1]. normal_scale: factor on x and y of the normal map.
    emissive: linear RGB radiance. Single-sided triangles are culled where their winding faces away from the viewer.
    """

    metallic: float
    roughness: float
    emissive: tuple[float, float, float]
    alpha_mode: AlphaMode
    alpha_cutoff: float
    double_sided: bool
    normal_scale: float
    occlusion_strength: float
    maps: Mapping[MapName, TextureMap]


VERTEX_ATTRIBUTES = {"tangents": 4, "second_uv": 2, "vertex_colors": 4}
"""The array fields of a `MetallicRoughness`, with their numbers of columns."""


@dataclass(frozen=True, eq=False)
class MetallicRoughness(MaterialSettings):
    """A glTF 2.0 metallic-roughness material, and the vertex attributes that only such a material uses.

    tangents: float32 [V,4], unit, with the sign of the bitangent cross(n, t); zeros without a normal map. second_uv:
    float32 [V,2], v upwards. vertex_colors: float32 [V,4], linear RGBA. given: whether its metallic and roughness are
    given by a scene, and not a file's.
    """

    tangents: Floats
    second_uv: Floats
    vertex_colors: Floats
    given: bool = False

    @property
    def solid(self) -> bool:
        """Whether nothing shows through it, from either side."""
        return self.alpha_mode == "OPAQUE" and self.double_sided

    @property
    def plain(self) -> bool:
        """Whether it is solid and has nothing but base colour, metallic and roughness."""
        dark = not any(self.emissive)
        return self.solid and dark and not self.maps and bool((self.vertex_colors == 1).all())


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles with one surface.

    vertices: float32 [V,3], scene units. normals: float32 [V,3], unit. faces: int32 [F,3], counter-clockwise seen from
    the side their normals point to. uv: float32 [V,2], v upwards (OpenGL), or None. color: float32 [4], linear RGBA.
    texture: uint8 [h,w,4], sRGB with straight alpha, row 0 at the top, or None; its colour is multiplied by `color`.
    metallic_roughness: the material of a glTF file, whose base colour texture is among its maps and not in `texture`;
    None for every other surface, which is Lambertian under a thin coat.
    """

    vertices: Floats
    normals: Floats
    faces: Integers
    uv: Floats | None = None
    color: Floats = field(default_factory=lambda: np.ones(4, np.float32))
    texture: Bytes | None = None
    metallic_roughness: MetallicRoughness | None = None

    @property
    def textured(self) -> bool:
        """Whether the surface has a texture of any kind."""
        return self.texture is not None or bool(self.metallic_roughness and self.metallic_roughness.maps)


@dataclass(frozen=True, eq=False)
class Mesh:
    """An object in its own frame: +y up, front towards +z, bounding-box centre at 0, bounding-sphere radius FIT_RADIUS.

    sha256 is the hex digest of the mesh's source; credit is the attribution line to show with the model, or None;
    centimetres is the real length of a scene unit at scale 1, or None where the real size is not known.
    """

    parts: tuple[Part, ...]
    sha256: str
    credit: str | None
    centimetres: float | None = None

    @property
    def triangles(self) -> int:
        """Number of triangles of all parts."""
        return sum(len(part.faces) for part in self.parts)


class TooLarge(ValueError):
    """A file can be read, but has more triangles or vertices than are taken."""


def check_size(max_faces: int, triangles: int, vertices: int = 0) -> None:
    """Raises TooLarge for more than `max_faces` triangles, and for more than three vertices for each of so many."""
    for count, what, most in ((triangles, "triangles", max_faces), (vertices, "vertices", 3 * max_faces)):
        if count > most:
            raise TooLarge(
                f"it declares {count:,} {what}, and at most {most:,} are taken; simplify it, by Blender's modifier "
                "Decimate or by trimesh's simplify_quadric_decimation, or raise the service's setting "
                "SCENE_ATTACK_MAX_FACES"
            )


def ball(parts: tuple[Part, ...]) -> tuple[Doubles, Doubles, float]:
    """Returns the lowest and highest corner of the parts' bounding box [3], and the radius of the ball about its middle
    that holds all vertices."""
    points = np.concatenate([part.vertices for part in parts]).astype(np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    return low, high, float(np.sqrt(((points - (low + high) / 2) ** 2).sum(axis=1).max()))


def fitted(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """Translates and uniformly scales the parts together so that they fit the frame (see `Mesh`).

    Raises Unreadable if all vertices are at the same point.
    """
    low, high, radius = ball(parts)
    centre = (low + high) / 2
    if not radius > 0:
        raise Unreadable("all vertices are at one point")
    scale = FIT_RADIUS / radius
    return tuple(
        replace(part, vertices=((part.vertices.astype(np.float64) - centre) * scale).astype(np.float32))
        for part in parts
    )
