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
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.renderer import Renderer

from services.rendering.extent import Rectangle, is_in_front
from services.rendering.framebuffer import Framebuffer
from services.rendering.geometry import Array, Drawing
from services.rendering.hidden import Faces
from services.rendering.program import Program
from services.scenes.mesh import Integers

TILE = 64
"""Pixels a side of the squares in which llvmpipe clears and draws."""

Image = NDArray[np.float32]
Insides = Literal["like outsides", "behind", "left out"]
"""How the insides of closed surfaces are drawn: like all faces, the nearest is seen; behind everything, where only a
hole in the outside would show them; or not."""


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


class FloatRenderer(Renderer):  # type: ignore[misc]
    """pyrender's renderer with float framebuffers and our shaders. One per process: see `gl`."""

    def __init__(self, surface: Any) -> None:
        super().__init__(1, 1)
        self._surface = surface  # keeps the context alive
        # By shader alone: there is one context. pyrender's cache is keyed by the context as PyOpenGL hands it out, on
        # OSMesa a new pointer object each time, so that every draw compiles again and leaks a program (3 MB).
        self._programs: dict[tuple[str, tuple[int, ...]], Program] = {}
        self._framebuffers: dict[bool, Framebuffer] = {}
        self._resident: Drawing | None = None
        self._all_faces, self._some_faces = (int(name) for name in GL.glGenBuffers(2))

    def __del__(self) -> None:
        """Nothing: the renderer lives as long as the process, and at its end the context may be gone already."""

    def check(self) -> None:
        """Raise where this driver cannot compile our shaders or draw to float32 with 4 samples."""
        for fragment in ("radiance.frag", "gbuffer.frag"):
            self.program(fragment, textured=True, holes=True, pictures=1, lights=1)
        self.sample_positions = self._target((4, 4), samples=4, outputs=1).positions()

    def program(self, fragment: str, *, textured: bool, holes: bool, pictures: int, lights: int) -> Program:
        """A fragment shader compiled for a kind of surface, a number of pictures and of lights; compiled once."""
        constants = {"TEXTURED": int(textured), "HOLES": int(holes), "PICTURES": pictures, "LIGHTS": lights}
        key = fragment, tuple(constants.values())
        if key not in self._programs:
            self._programs[key] = Program(fragment, constants)
        return self._programs[key]

    def _target(self, size: tuple[int, int], samples: int, outputs: int, whole: bool = True) -> Framebuffer:
        """A framebuffer for whole pictures, of just that size; or one for parts of pictures, of at least that size."""
        held = self._framebuffers.get(whole)
        if held is not None and not whole:
            size = max(size[0], held.size[0]), max(size[1], held.size[1])
        if held is None or (held.size, held.samples) != (size, samples) or held.outputs < outputs:
            self._drop(whole)
            held = self._framebuffers[whole] = Framebuffer(size, samples, outputs)
        return held

    def _drop(self, whole: bool) -> None:
        if whole in self._framebuffers:
            self._framebuffers.pop(whole).delete()

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
        lights: int = 0,
        rectangle: Rectangle | None = None,
        insides: Insides = "like outsides",
        faces: Faces | None = None,
    ) -> Image:
        """One pass over the geometry: what the fragment shader writes to each output, 0 where nothing is;
        [outputs, height, width, 4], or a `rectangle` of it. The first row is the bottom one, as OpenGL has it.

        poses [objects, 4, 4] world_from_object; colors [pictures, objects, 3] linear factors on the base colours;
        `uniforms` of the pass, and `object_uniforms` with one value per object. With `blend` the parts that are not
        opaque come last, the far ones first, over what is behind them (colours times opacity); else all parts are
        drawn alike. For `insides` see there; the insides of an object that reaches to the camera are drawn like all.
        `faces` are the only ones that are drawn, as `hidden.seen` finds them for the same poses and insides; None: all.

        Raises RuntimeError for an error of OpenGL (out of memory).
        """
        if self._resident is not drawing:
            self._update_context(drawing, 0)
            self._resident = drawing
            self._drop(whole=False)  # parts of its pictures may be smaller
            _fill(self._all_faces, np.concatenate([piece.triangles for piece in drawing.pieces]), GL.GL_STATIC_DRAW)
        if faces is not None:
            _fill(self._some_faces, faces.triangles, GL.GL_STREAM_DRAW)
        rectangle = rectangle or (0, size[0], 0, size[1])
        target = _up_to(rectangle, size)
        framebuffer = self._target(target, samples, outputs, whole=target == size)
        framebuffer.begin(outputs, size)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glBlendFunc(GL.GL_ONE, GL.GL_ONE_MINUS_SRC_ALPHA)
        (GL.glEnable if samples > 1 else GL.glDisable)(GL.GL_MULTISAMPLE)
        GL.glFrontFace(GL.GL_CCW)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        if faces is not None:
            counts = faces.counts.tolist()
        else:
            closed = closed_faces(drawing, view, poses) if insides != "like outsides" else [0] * len(drawing.pieces)
            counts = [(count, piece.faces - count) for count, piece in zip(closed, drawing.pieces, strict=True)]
        starts = np.cumsum([0] + [sum(count) for count in counts])
        of_objects = [_of_object(view, pose) for pose in poses]
        ready: dict[Program, int] = {}
        """The object whose pose each program has; all of those here have the uniforms of the pass."""
        for number in _ordered(drawing, poses, view.eye) if blend else range(len(drawing.pieces)):
            piece, start = drawing.pieces[number], int(starts[number])
            if not sum(counts[number]):
                continue
            program = self.program(
                fragment,
                textured=piece.texture is not None,
                holes=piece.holes,
                pictures=len(colors),
                lights=lights,
            )
            program._bind()
            if program not in ready:
                for name, value in ({"eye": view.eye} | dict(uniforms)).items():
                    program.set(name, value)
            if ready.get(program) != piece.index:
                for name, value in of_objects[piece.index].items():
                    program.set(name, value)
                for name, values in object_uniforms.items():
                    program.set(name, values[piece.index])
            ready[program] = piece.index
            program.set("base_colors[0]", piece.part.color[:3] * colors[:, piece.index])
            program.set("opacity", float(piece.part.color[3]))
            if piece.texture is not None:
                program.set("base_color_texture", 0)
                piece.texture._bind()
            see_through = blend and not piece.solid
            (GL.glEnable if see_through else GL.glDisable)(GL.GL_BLEND)
            GL.glDepthMask(GL.GL_FALSE if see_through else GL.GL_TRUE)
            piece.primitive._bind()
            GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, self._all_faces if faces is None else self._some_faces)
            middle, stop = start + counts[number][0], start + sum(counts[number])
            _draw_faces(start, middle, GL.GL_BACK)
            if insides == "behind":
                GL.glDepthRange(1.0, 1.0)
                GL.glDepthFunc(GL.GL_LEQUAL)
                _draw_faces(start, middle, GL.GL_FRONT)
                GL.glDepthRange(0.0, 1.0)
                GL.glDepthFunc(GL.GL_LESS)
            _draw_faces(middle, stop, None)
        GL.glBindVertexArray(0)
        images = framebuffer.read(outputs, rectangle, size)
        error = GL.glGetError()
        if error != GL.GL_NO_ERROR:
            raise RuntimeError(f"OpenGL error {error:#x} while drawing {size[1]}x{size[0]} pixels")
        return images


def _up_to(rectangle: Rectangle, size: tuple[int, int]) -> tuple[int, int]:
    """The size of what lies between a picture's lower left corner and a rectangle's upper right one, in whole tiles."""
    top, _, _, right = rectangle
    return min(size[0], -(-(size[0] - top) // TILE) * TILE), min(size[1], -(-right // TILE) * TILE)


def _draw_faces(start: int, stop: int, hidden: Any) -> None:
    """Some of the bound faces of the bound piece, of which one side may be hidden. Without: both, for furniture is
    modelled with sheets, and windings differ.
    """
    if start == stop:
        return
    if hidden is None:
        GL.glDisable(GL.GL_CULL_FACE)
    else:
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glCullFace(hidden)
    GL.glDrawElements(GL.GL_TRIANGLES, 3 * (stop - start), GL.GL_UNSIGNED_INT, ctypes.c_void_p(12 * start))


def _of_object(view: View, pose: Array) -> dict[str, NDArray[Any]]:
    """The uniforms of an object at a pose [4,4]."""
    return {
        "clip_from_object": view.clip_from_world @ pose,
        "world_from_object": pose,
        "normal_from_object": np.linalg.inv(pose[:3, :3]).T,
    }


def closed_faces(drawing: Drawing, view: View, poses: Array) -> list[int]:
    """How many faces of each piece are of closed surfaces: at poses where the object reaches to the camera, none."""
    in_front = [
        is_in_front(points, view.clip_from_world @ pose) for points, pose in zip(drawing.points, poses, strict=True)
    ]
    return [piece.closed if in_front[piece.index] else 0 for piece in drawing.pieces]


def _fill(buffer: int, triangles: Integers, usage: Any) -> None:
    GL.glBindBuffer(GL.GL_ARRAY_BUFFER, buffer)
    GL.glBufferData(GL.GL_ARRAY_BUFFER, triangles.nbytes, triangles, usage)
    GL.glBindBuffer(GL.GL_ARRAY_BUFFER, 0)


def _ordered(drawing: Drawing, poses: Array, eye: Array) -> list[int]:
    """Which pieces: opaque ones in the scene's order, then the others from far to near by the middle of their bounding
    box."""

    def nearness(number: int) -> float:
        piece = drawing.pieces[number]
        pose = poses[piece.index]
        return -float(np.linalg.norm(pose[:3, :3] @ piece.centre + pose[:3, 3] - eye))

    solid = [number for number, piece in enumerate(drawing.pieces) if piece.solid]
    return solid + sorted((number for number, piece in enumerate(drawing.pieces) if not piece.solid), key=nearness)


def describe() -> str:
    """Driver and libraries of the current context."""
    driver = GL.glGetString(GL.GL_RENDERER).decode()
    return (
        f"{driver}; OpenGL {GL.glGetString(GL.GL_VERSION).decode()}; float32, 4 samples; "
        f"pyrender-maintained {version('pyrender-maintained')}; PyOpenGL {version('PyOpenGL')}"
    )
