"""Meshes and textures as OpenGL holds them. Imports OpenGL, so import it only through `context.current()`."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyrender.material import MetallicRoughnessMaterial
from pyrender.primitive import Primitive

from services.rendering.opengl.material_upload import Textures, UploadedMaterial, upload_material
from services.rendering.opengl.textures import LinearTexture, SrgbTexture
from services.rendering.opengl.watertight import has_holes, outsides
from services.scenes.mesh import Integers, Mesh, MetallicRoughness, Part

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Piece:
    """One part of one object, ready to draw. Of its faces the first `n_watertight_faces` belong to watertight
    surfaces (see `watertight`)."""

    index: int
    part: Part
    triangles: Integers
    """int32 [F, 3], in the order they are drawn."""
    primitive: Any
    texture: LinearTexture | None
    holes: bool
    n_watertight_faces: int
    centre: Array
    material: UploadedMaterial | None

    @property
    def metallic_roughness(self) -> MetallicRoughness | None:
        """The material of a glTF file; None for the Lambertian body under a coat that all other surfaces have."""
        return self.part.metallic_roughness

    @property
    def solid(self) -> bool:
        """Whether nothing shows through it."""
        if self.metallic_roughness is not None:
            return self.metallic_roughness.alpha_mode != "BLEND"
        return bool(self.part.color[3] >= 1)

    @property
    def single_sided(self) -> bool:
        """Whether a face is seen from its front only."""
        return self.metallic_roughness is not None and not self.metallic_roughness.double_sided

    @property
    def faces(self) -> int:
        """How many triangles it has."""
        return len(self.part.faces)


@dataclass(frozen=True, eq=False)
class Upload:
    """A group of primitives that are uploaded together, with the attributes that pyrender's renderer reads."""

    primitives: tuple[Any, ...]


class Drawing:
    """The geometry of a scene's objects as pyrender primitives; uploaded when first drawn, dropped when another is.

    Unless `watertight`, no surface is taken for watertight: all faces are drawn alike, and the nearest is seen.
    """

    def __init__(self, meshes: Sequence[Mesh], watertight: bool = False) -> None:
        textures: Textures = {}
        uploads: dict[int, list[_UploadedPart]] = {}
        corners: dict[int, Array] = {}
        self.pieces: list[Piece] = []
        self.points: list[Array] = []
        """Per object its corners, homogeneous [4,V], each once."""
        for index, mesh in enumerate(meshes):
            if id(mesh) not in uploads:
                wound = outsides(mesh) if watertight else [(part.faces, 0) for part in mesh.parts]
                uploads[id(mesh)] = [
                    _upload(part, np.ascontiguousarray(faces, np.int32), count, textures)
                    for part, (faces, count) in zip(mesh.parts, wound, strict=True)
                ]
                corners[id(mesh)] = _corners(mesh)
            for part, held in zip(mesh.parts, uploads[id(mesh)], strict=True):
                centre = (part.vertices.min(axis=0) + part.vertices.max(axis=0)).astype(np.float64) / 2
                self.pieces.append(
                    Piece(
                        index,
                        part,
                        held.triangles,
                        held.primitive,
                        held.texture,
                        has_holes(part),
                        held.n_watertight_faces,
                        centre,
                        held.material,
                    )
                )
            self.points.append(corners[id(mesh)])
        # What pyrender's Renderer._update_context asks of a scene.
        self.meshes = {Upload(tuple(held.primitive for held in upload)) for upload in uploads.values()}
        self.lights: tuple[()] = ()


@lru_cache(maxsize=1)
def closed_drawing(meshes: tuple[Mesh, ...]) -> Drawing:
    """The drawing of meshes with their watertight surfaces. The last one is kept: a job that attacks the same meshes as
    the one before finds them prepared, and uploaded.
    """
    return Drawing(meshes, watertight=True)


def _corners(mesh: Mesh) -> Array:
    """Returns a mesh's vertices, each once, homogeneous [4, V]."""
    found = np.unique(np.concatenate([part.vertices for part in mesh.parts]), axis=0).astype(np.float64)
    return np.ascontiguousarray(np.append(found, np.ones((len(found), 1)), axis=1).T)


class _UploadedPart(NamedTuple):
    triangles: Integers
    primitive: Any
    texture: LinearTexture | None
    n_watertight_faces: int
    material: UploadedMaterial | None


def _upload(part: Part, faces: Integers, n_watertight_faces: int, textures: Textures) -> _UploadedPart:
    if part.metallic_roughness is not None:
        primitive, material = upload_material(part, part.metallic_roughness, faces, textures)
        return _UploadedPart(faces, primitive, None, n_watertight_faces, material)
    texture = None
    if part.texture is not None and part.uv is not None:
        key = id(part.texture), True, LinearTexture.wrap
        texture = textures.setdefault(key, SrgbTexture(source=part.texture, source_channels="RGBA"))
    primitive = Primitive(
        positions=part.vertices,
        normals=part.normals,
        # One vertex layout for all.
        texcoord_0=np.zeros((len(part.vertices), 2), np.float32) if part.uv is None else part.uv,
        indices=faces,
        material=MetallicRoughnessMaterial(baseColorTexture=texture),
    )
    return _UploadedPart(faces, primitive, texture, n_watertight_faces, None)
