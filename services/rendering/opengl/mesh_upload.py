"""Meshes and textures as OpenGL holds them. Imports OpenGL, so import it only through `context.current()`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.material import MetallicRoughnessMaterial
from pyrender.primitive import Primitive
from pyrender.texture import Texture

from services.rendering.opengl.watertight import has_holes, outsides
from services.scenes.mesh import Integers, Mesh, Part

Array = NDArray[np.float64]


class SrgbTexture(Texture):  # type: ignore[misc]
    """A repeated sRGB texture, decoded to linear before it is filtered (pyrender's are filtered as they are stored)."""

    _levels: list[NDArray[np.uint8]] | None = None

    def _add_to_context(self) -> None:
        height, width = self.source.shape[:2]
        self._texid = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
        # OpenGL's first row is v = 0, the bottom of the picture.
        rows = np.ascontiguousarray(self.source[::-1])
        GL.glTexImage2D(
            GL.GL_TEXTURE_2D, 0, GL.GL_SRGB8_ALPHA8, width, height, 0, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, rows
        )
        GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_S, GL.GL_REPEAT)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_T, GL.GL_REPEAT)
        GL.glBindTexture(GL.GL_TEXTURE_2D, 0)

    def levels(self) -> list[NDArray[np.uint8]]:
        """The driver's mipmaps, each [height, width, 4] sRGB with its first row at v = 0; from when it was uploaded."""
        if self._levels is None:
            self._levels = []
            GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
            GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
            size = np.array(self.source.shape[:2])
            for level in range(int(size.max()).bit_length()):
                texels = np.empty((*np.maximum(size >> level, 1), 4), np.uint8)
                GL.glGetTexImage(GL.GL_TEXTURE_2D, level, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, array=texels)
                self._levels.append(texels)
            GL.glBindTexture(GL.GL_TEXTURE_2D, 0)
        return self._levels


@dataclass(frozen=True)
class Piece:
    """One part of one object, ready to draw. Of its faces the first `closed` are of closed surfaces (see `closed`)."""

    index: int
    part: Part
    triangles: Integers
    """int32 [F, 3], in the order they are drawn."""
    primitive: Any
    texture: SrgbTexture | None
    holes: bool
    closed: int
    centre: Array

    @property
    def solid(self) -> bool:
        """Whether nothing shows through it."""
        return bool(self.part.color[3] >= 1)

    @property
    def faces(self) -> int:
        """How many triangles it has."""
        return len(self.part.faces)


@dataclass(frozen=True, eq=False)
class Upload:
    """What goes to the context as one: all that pyrender's renderer asks of a mesh."""

    primitives: tuple[Any, ...]


class Drawing:
    """The geometry of a scene's objects as pyrender primitives; uploaded when first drawn, dropped when another is.

    Unless `closed`, no surface is taken for closed: all faces are drawn alike, and the nearest is seen.
    """

    def __init__(self, meshes: Sequence[Mesh], closed: bool = False) -> None:
        textures: dict[int, SrgbTexture] = {}
        uploads: dict[int, list[tuple[Integers, Any, SrgbTexture | None, int]]] = {}
        self.pieces: list[Piece] = []
        self.points: list[Array] = []
        """Per object its corners, homogeneous [4,V], each once."""
        for index, mesh in enumerate(meshes):
            if id(mesh) not in uploads:
                wound = outsides(mesh) if closed else [(part.faces, 0) for part in mesh.parts]
                uploads[id(mesh)] = [
                    (np.ascontiguousarray(faces, np.int32), *_primitive(part, faces, textures), count)
                    for part, (faces, count) in zip(mesh.parts, wound, strict=True)
                ]
            for part, (faces, primitive, texture, count) in zip(mesh.parts, uploads[id(mesh)], strict=True):
                centre = (part.vertices.min(axis=0) + part.vertices.max(axis=0)).astype(np.float64) / 2
                self.pieces.append(Piece(index, part, faces, primitive, texture, has_holes(part), count, centre))
            corners = np.unique(np.concatenate([part.vertices for part in mesh.parts]), axis=0).astype(np.float64)
            self.points.append(np.ascontiguousarray(np.append(corners, np.ones((len(corners), 1)), axis=1).T))
        # What pyrender's Renderer._update_context asks of a scene.
        self.meshes = {Upload(tuple(primitive for _, primitive, *_ in upload)) for upload in uploads.values()}
        self.lights: tuple[()] = ()


def _primitive(part: Part, faces: Integers, textures: dict[int, SrgbTexture]) -> tuple[Any, SrgbTexture | None]:
    texture = None
    if part.texture is not None and part.uv is not None:
        texture = textures.setdefault(id(part.texture), SrgbTexture(source=part.texture, source_channels="RGBA"))
    primitive = Primitive(
        positions=part.vertices,
        normals=part.normals,
        # One vertex layout for all.
        texcoord_0=np.zeros((len(part.vertices), 2), np.float32) if part.uv is None else part.uv,
        indices=faces,
        material=MetallicRoughnessMaterial(baseColorTexture=texture),
    )
    return primitive, texture
