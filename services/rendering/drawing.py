"""Drawing meshes into floating-point framebuffers with pyrender. Imported by `gl.context()` only, after the platform
is chosen.

pyrender uploads geometry and textures and compiles programs; the pass over the parts is ours, because pyrender's own
goes through a set (unordered, so not the same bits twice), swallows the errors of uniforms that do not exist, clamps
to [0,1], applies a gamma curve, and hands back 8 bits.
"""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import pyrender
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.texture import Texture

from services.rendering.framebuffer import Framebuffer
from services.rendering.program import Program
from services.scenes.mesh import Mesh, Part

Array = NDArray[np.float64]
Image = NDArray[np.float32]


class SrgbTexture(Texture):  # type: ignore[misc]
    """A repeated sRGB texture, decoded to linear before it is filtered (pyrender's are filtered as they are stored)."""

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


@dataclass(frozen=True)
class Piece:
    """One part of one object, ready to draw."""

    index: int
    part: Part
    primitive: Any
    texture: SrgbTexture
    centre: Array

    @property
    def solid(self) -> bool:
        """Whether nothing shows through it."""
        return bool(self.part.color[3] >= 1)


class Drawing:
    """The geometry of a scene's objects as pyrender primitives; uploaded when first drawn, dropped when another is."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        textures: dict[int | None, SrgbTexture] = {}
        textures[None] = SrgbTexture(source=np.full((1, 1, 4), 255, np.uint8), source_channels="RGBA")
        uploads: dict[int, list[tuple[Any, SrgbTexture]]] = {}
        self.pieces: list[Piece] = []
        for index, mesh in enumerate(meshes):
            if id(mesh) not in uploads:
                uploads[id(mesh)] = [_primitive(part, textures) for part in mesh.parts]
            for part, (primitive, texture) in zip(mesh.parts, uploads[id(mesh)], strict=True):
                centre = (part.vertices.min(axis=0) + part.vertices.max(axis=0)).astype(np.float64) / 2
                self.pieces.append(Piece(index, part, primitive, texture, centre))
        # What pyrender's Renderer._update_context asks of a scene.
        self.meshes = {pyrender.Mesh([primitive for primitive, _ in upload]) for upload in uploads.values()}
        self.lights: tuple[()] = ()


def _primitive(part: Part, textures: dict[int | None, SrgbTexture]) -> tuple[Any, SrgbTexture]:
    key = None if part.texture is None or part.uv is None else id(part.texture)
    if key not in textures:
        textures[key] = SrgbTexture(source=part.texture, source_channels="RGBA")
    # One vertex layout for all, so that one program draws them all.
    uv = np.zeros((len(part.vertices), 2), np.float32) if part.uv is None else part.uv
    primitive = pyrender.Primitive(
        positions=part.vertices,
        normals=part.normals,
        texcoord_0=uv,
        indices=part.faces,
        material=pyrender.MetallicRoughnessMaterial(baseColorTexture=textures[key]),
    )
    return primitive, textures[key]


@dataclass(frozen=True)
class View:
    """A camera: clip_from_world [4,4], its position `eye` [3] and unit viewing direction `forward` [3], float64."""

    clip_from_world: Array
    eye: Array
    forward: Array

    @classmethod
    def of(cls, world_from_camera: Array, projection: Array) -> "View":
        """From a camera-to-world matrix with OpenGL axes (it looks along its -z) and a projection matrix."""
        camera = np.asarray(world_from_camera, np.float64)
        return cls(np.asarray(projection, np.float64) @ np.linalg.inv(camera), camera[:3, 3], -camera[:3, 2])


class FloatRenderer(pyrender.Renderer):  # type: ignore[misc]
    """pyrender's renderer with float framebuffers and our shaders. One per process: see `gl`."""

    def __init__(self, surface: Any) -> None:
        super().__init__(1, 1)
        self._surface = surface  # keeps the context alive
        # By shader alone: there is one context. pyrender's cache is keyed by the context as PyOpenGL hands it out, on
        # OSMesa a new pointer object each time, so that every draw compiles again and leaks a program (3 MB).
        self._programs: dict[str, Program] = {}
        self._framebuffer: Framebuffer | None = None
        self._resident: Drawing | None = None

    def __del__(self) -> None:
        """Nothing: the renderer lives as long as the process, and at its end the context may be gone already."""

    def check(self) -> None:
        """Raise where this driver cannot compile our shaders or draw to float32 with 4 samples."""
        for fragment in ("radiance.frag", "gbuffer.frag"):
            self._program(fragment)
        self._target((4, 4), samples=4, outputs=1)

    def _program(self, fragment: str) -> Program:
        if fragment not in self._programs:
            self._programs[fragment] = Program(fragment)
        return self._programs[fragment]

    def _target(self, size: tuple[int, int], samples: int, outputs: int) -> Framebuffer:
        if self._framebuffer is None or self._framebuffer.key != (size, samples, outputs):
            if self._framebuffer is not None:
                self._framebuffer.delete()
                self._framebuffer = None
            self._framebuffer = Framebuffer(size, samples, outputs)
        return self._framebuffer

    def draw(
        self,
        drawing: Drawing,
        fragment: str,
        view: View,
        poses: Array,
        colors: Array,
        uniforms: Mapping[str, Any],
        object_uniforms: Mapping[str, Sequence[float]],
        *,
        size: tuple[int, int],
        samples: int,
        outputs: int,
        blend: bool,
    ) -> list[Image]:
        """One frame: `outputs` images [height, width, 4] of what the fragment shader writes, 0 where nothing is.

        poses [objects, 4, 4] world_from_object; colors [objects, 3] linear factors on the base colours; `uniforms` of
        the frame, and `object_uniforms` with one value per object. With `blend` the parts that are not opaque come
        last, the far ones first, over what is behind them (colours times opacity); else all parts are drawn alike.
        """
        if self._resident is not drawing:
            self._update_context(drawing, 0)
            self._resident = drawing
        framebuffer = self._target(size, samples, outputs)
        framebuffer.begin()
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glDisable(GL.GL_CULL_FACE)  # two-sided: furniture is modelled with sheets, and windings differ
        GL.glBlendFunc(GL.GL_ONE, GL.GL_ONE_MINUS_SRC_ALPHA)
        (GL.glEnable if samples > 1 else GL.glDisable)(GL.GL_MULTISAMPLE)

        program = self._program(fragment)
        program._bind()
        program.set("eye", view.eye)
        program.set("base_color_texture", 0)
        for name, value in uniforms.items():
            program.set(name, value)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        for piece in self._ordered(drawing, poses, view.eye) if blend else drawing.pieces:
            see_through = blend and not piece.solid
            (GL.glEnable if see_through else GL.glDisable)(GL.GL_BLEND)
            GL.glDepthMask(GL.GL_FALSE if see_through else GL.GL_TRUE)
            pose = poses[piece.index]
            program.set("clip_from_object", view.clip_from_world @ pose)
            program.set("world_from_object", pose)
            program.set("normal_from_object", np.linalg.inv(pose[:3, :3]).T)
            program.set("base_color", piece.part.color * np.append(colors[piece.index], 1.0))
            for name, values in object_uniforms.items():
                program.set(name, values[piece.index])
            piece.texture._bind()
            piece.primitive._bind()
            GL.glDrawElements(GL.GL_TRIANGLES, piece.primitive.indices.size, GL.GL_UNSIGNED_INT, ctypes.c_void_p(0))
        GL.glBindVertexArray(0)
        program._unbind()
        return framebuffer.read()

    @staticmethod
    def _ordered(drawing: Drawing, poses: Array, eye: Array) -> list[Piece]:
        """Opaque parts in the scene's order, then the others from far to near by the middle of their bounding box."""

        def nearness(piece: Piece) -> float:
            pose = poses[piece.index]
            return -float(np.linalg.norm(pose[:3, :3] @ piece.centre + pose[:3, 3] - eye))

        solid = [piece for piece in drawing.pieces if piece.solid]
        return solid + sorted((piece for piece in drawing.pieces if not piece.solid), key=nearness)


def describe() -> str:
    """Driver and libraries of the current context."""
    driver = GL.glGetString(GL.GL_RENDERER).decode()
    return (
        f"{driver}; OpenGL {GL.glGetString(GL.GL_VERSION).decode()}; float32, 4 samples; "
        f"pyrender-maintained {version('pyrender-maintained')}; PyOpenGL {version('PyOpenGL')}"
    )
