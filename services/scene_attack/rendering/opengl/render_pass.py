"""Drawing meshes into floating-point framebuffers with pyrender. Imports OpenGL, so import it only through
`context.current()`, after the platform is chosen.

pyrender uploads geometry and textures and compiles programs; the pass over the parts is ours, because pyrender's own
goes through a set (unordered, so not the same bits twice), swallows the errors of uniforms that do not exist, clamps to
[0,1], applies a gamma curve, and hands back 8 bits.
"""

import ctypes
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.renderer import Renderer

from scene_attack.rendering.opengl.camera import CameraMatrices, LightCounts, Rectangle, n_watertight_faces, ordered
from scene_attack.rendering.opengl.mesh_upload import NO_MATERIAL, Array, Drawing, Piece, Program, UploadedMaterial
from scene_attack.rendering.opengl.shadow_maps import ShadowMaps
from scene_attack.rendering.opengl.shadows import PassShadows


class Framebuffer:
    """Up to `outputs` RGBA float32 images of `size` (height, width) with a depth buffer, and `samples` per pixel.

    With several samples, colours are drawn to a multisampled twin and averaged when read. Raises RuntimeError where
    the driver cannot draw to float32.
    """

    def __init__(self, size: tuple[int, int], samples: int, outputs: int) -> None:
        self.key = (size, samples)
        self.size, self.samples, self.outputs = size, samples, outputs
        self._buffers: list[int] = []
        self._frames: list[int] = []
        self._draw = self._make(samples if samples > 1 else 0, outputs, depth=True)
        self._read = self._make(0, 1, depth=False) if samples > 1 else self._draw

    def _make(self, samples: int, outputs: int, depth: bool) -> int:
        height, width = self.size
        frame = int(GL.glGenFramebuffers(1))
        self._frames.append(frame)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, frame)
        attachments = [(GL.GL_COLOR_ATTACHMENT0 + i, GL.GL_RGBA32F) for i in range(outputs)]
        if depth:
            attachments.append((GL.GL_DEPTH_ATTACHMENT, GL.GL_DEPTH_COMPONENT32F))
        for attachment, storage in attachments:
            buffer = int(GL.glGenRenderbuffers(1))
            self._buffers.append(buffer)
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            GL.glRenderbufferStorageMultisample(GL.GL_RENDERBUFFER, samples, storage, width, height)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)
        status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        if status != GL.GL_FRAMEBUFFER_COMPLETE:
            raise RuntimeError(f"no {samples}-sample float32 framebuffer of {width}x{height} here (status {status:#x})")
        return frame

    def begin(self, outputs: int) -> None:
        """Make its first `outputs` images the target of drawing, cleared to zero."""
        height, width = self.size
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._draw)
        GL.glDrawBuffers(outputs, [GL.GL_COLOR_ATTACHMENT0 + i for i in range(outputs)])
        GL.glViewport(0, 0, width, height)
        GL.glDepthMask(GL.GL_TRUE)
        GL.glClearColor(0.0, 0.0, 0.0, 0.0)
        GL.glClear(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)

    def read(self, outputs: int, rectangle: Rectangle) -> NDArray[np.float32]:
        """Returns a rectangle of the first `outputs` images, [outputs, rows, columns, 4]; the first row is the bottom
        one.
        """
        top, bottom, left, right = rectangle
        low, high = self.size[0] - bottom, self.size[0] - top
        images = np.empty((outputs, high - low, right - left, 4), np.float32)
        for i, image in enumerate(images):
            GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._draw)
            GL.glReadBuffer(GL.GL_COLOR_ATTACHMENT0 + i)
            if self._read != self._draw:
                GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self._read)
                GL.glBlitFramebuffer(
                    left, low, right, high, left, low, right, high, GL.GL_COLOR_BUFFER_BIT, GL.GL_NEAREST
                )
                GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._read)
                GL.glReadBuffer(GL.GL_COLOR_ATTACHMENT0)
            GL.glReadPixels(left, low, right - left, high - low, GL.GL_RGBA, GL.GL_FLOAT, array=image)
        return images

    def positions(self) -> NDArray[np.float64]:
        """Returns the positions of the samples in a pixel, [samples, 2]: x and y from the lower left corner."""
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._draw)
        positions = [np.zeros(2, np.float32) for _ in range(self.samples)]
        for i, position in enumerate(positions):
            GL.glGetMultisamplefv(GL.GL_SAMPLE_POSITION, i, position)
        return np.array(positions, np.float64)

    def delete(self) -> None:
        """Frees the memory of its images."""
        GL.glDeleteFramebuffers(len(self._frames), self._frames)
        GL.glDeleteRenderbuffers(len(self._buffers), self._buffers)


Image = NDArray[np.float32]
Backfaces = Literal["draw", "behind", "cull"]
"""Treatment of the backfaces of watertight surfaces. "draw": they are drawn like all faces, and the nearest is seen.
"behind": they are drawn behind everything, so that they show only through a hole in the outside. "cull": they are not
drawn."""


class FloatRenderer(Renderer):  # type: ignore[misc]
    """pyrender's renderer with float framebuffers and our shaders. One per process: see `gl`."""

    def __init__(self, surface: Any) -> None:
        super().__init__(1, 1)
        self._surface = surface  # keeps the context alive
        # By shader alone: there is one context. pyrender's cache is keyed by the context as PyOpenGL hands it out, on
        # OSMesa a new pointer object each time, so that every draw compiles again and leaks a program (3 MB).
        self._programs: dict[tuple[str, tuple[int, ...]], Program] = {}
        self._framebuffer: Framebuffer | None = None
        self._resident: Drawing | None = None
        self._shadow_maps: ShadowMaps | None = None

    def __del__(self) -> None:
        """Nothing: the renderer lives as long as the process, and at its end the context may be gone already."""

    def check(self) -> None:
        """Raise where this driver cannot compile our shaders or draw to float32 with 4 samples."""
        for fragment in ("radiance.frag", "gbuffer.frag"):
            self.program(fragment, textured=True, holes=True, n_images=1, lights=(1, 0, 0))
        self.sample_positions = self._target((4, 4), samples=4, outputs=1).positions()

    def program(
        self,
        fragment: str,
        *,
        textured: bool,
        holes: bool,
        n_images: int,
        lights: LightCounts,
        material: UploadedMaterial | None = None,
        shadows: bool = False,
    ) -> Program:
        """A fragment shader compiled for a kind of surface, a number of images and of lights; compiled once."""
        constants = {
            "TEXTURED": int(textured),
            "HOLES": int(holes),
            "IMAGES": n_images,
            "SHADOWS": int(shadows),
            **dict(zip(("LIGHTS", "DIRECTIONAL_LIGHTS", "SPOT_LIGHTS"), lights, strict=True)),
            **(NO_MATERIAL if material is None else material.constants),
        }
        key = fragment, tuple(constants.values())
        if key not in self._programs:
            self._programs[key] = Program(fragment, constants)
        return self._programs[key]

    def _shadowed(self, drawing: Drawing, poses: Array, shadows: PassShadows) -> dict[str, Any]:
        """The shadow maps of a pass, drawn and bound, as uniforms."""
        if self._shadow_maps is None:
            self._shadow_maps = ShadowMaps(self._depth_program)
        return self._shadow_maps.uniforms(drawing, poses, shadows)

    def _depth_program(self, piece: Piece) -> Program:
        textured = piece.holes and piece.texture is not None
        of: dict[str, Any] = {
            "textured": textured,
            "holes": piece.holes,
            "n_images": 1,
            "lights": (0, 0, 0),
            "material": piece.material,
        }
        return self.program("shadow_depth.frag", **of)

    def _target(self, size: tuple[int, int], samples: int, outputs: int) -> Framebuffer:
        held = self._framebuffer
        if held is None or held.key != (size, samples) or held.outputs < outputs:
            if held is not None:
                held.delete()
                self._framebuffer = None
            self._framebuffer = held = Framebuffer(size, samples, outputs)
        return held

    def draw(
        self,
        drawing: Drawing,
        fragment: str,
        view: CameraMatrices,
        poses: Array,
        colors: Array,
        uniforms: Mapping[str, Any],
        object_uniforms: Mapping[str, Sequence[float]],
        *,
        size: tuple[int, int],
        samples: int,
        outputs: int,
        blend: bool,
        lights: LightCounts = (0, 0, 0),
        rectangle: Rectangle | None = None,
        backfaces: Backfaces = "draw",
        shadows: PassShadows | None = None,
    ) -> Image:
        """Draws one pass over the geometry. Returns the values that the fragment shader writes to each output, 0 where
        nothing is, [outputs, height, width, 4], or a `rectangle` of them. The first row is the bottom one, as OpenGL
        has it.

        poses [objects, 4, 4] world_from_object; colors [images, objects, 3] linear factors on the base colours;
        `uniforms` of the pass, and `object_uniforms` with one value per object. With `blend` the parts that are not
        opaque come last, the far ones first, over what is behind them (colours times opacity); else all parts are
        drawn alike. The backs of single-sided glTF materials are never drawn. For `backfaces` see there; those of
        an object that reaches to the camera are drawn like all.

        Raises RuntimeError for an error of OpenGL (out of memory).
        """
        if self._resident is not drawing:
            self._update_context(drawing, 0)
            self._resident = drawing
        if shadows is not None:
            uniforms = {**uniforms, **self._shadowed(drawing, poses, shadows)}
        framebuffer = self._target(size, samples, outputs)
        framebuffer.begin(outputs)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glBlendFunc(GL.GL_ONE, GL.GL_ONE_MINUS_SRC_ALPHA)
        (GL.glEnable if samples > 1 else GL.glDisable)(GL.GL_MULTISAMPLE)
        GL.glFrontFace(GL.GL_CCW)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        watertight = n_watertight_faces(drawing, view, poses) if backfaces != "draw" else [0] * len(drawing.pieces)
        of_objects = view.matrices(poses)
        ready: dict[Program, int] = {}
        """The object whose pose each program has; all of those here have the uniforms of the pass."""
        for number in ordered(drawing, view, poses) if blend else range(len(drawing.pieces)):
            piece = drawing.pieces[number]
            program = self.program(
                fragment,
                textured=piece.texture is not None,
                holes=piece.holes,
                n_images=len(colors),
                lights=lights,
                material=piece.material,
                shadows=shadows is not None,
            )
            program._bind()
            if program not in ready:
                for name, value in ({"eye": view.eye} | dict(uniforms)).items():
                    if piece.material is None or program.has(name):  # opaque materials need no opacity thresholds
                        program.set(name, value)
            if ready.get(program) != piece.index:
                for name, value in of_objects[piece.index].items():
                    program.set(name, value)
                for name, values in object_uniforms.items():
                    program.set(name, values[piece.index])
            ready[program] = piece.index
            program.set("base_colors[0]", piece.part.color[:3] * colors[:, piece.index])
            if piece.texture is not None:
                program.set("base_color_texture", 0)
                piece.texture._bind()
            if piece.material is None:
                program.set("opacity", float(piece.part.color[3]))
            else:
                piece.material.bind(program)
            see_through = blend and not piece.solid
            (GL.glEnable if see_through else GL.glDisable)(GL.GL_BLEND)
            GL.glDepthMask(GL.GL_FALSE if see_through else GL.GL_TRUE)
            piece.primitive._bind()
            _draw_faces(0, watertight[number], GL.GL_BACK)
            if backfaces == "behind":
                GL.glDepthRange(1.0, 1.0)
                GL.glDepthFunc(GL.GL_LEQUAL)
                _draw_faces(0, watertight[number], GL.GL_FRONT)
                GL.glDepthRange(0.0, 1.0)
                GL.glDepthFunc(GL.GL_LESS)
            _draw_faces(watertight[number], piece.faces, GL.GL_BACK if piece.single_sided else None)
        GL.glBindVertexArray(0)
        images = framebuffer.read(outputs, rectangle or (0, size[0], 0, size[1]))
        error = GL.glGetError()
        if error != GL.GL_NO_ERROR:
            raise RuntimeError(f"OpenGL error {error:#x} while drawing {size[1]}x{size[0]} pixels")
        return images


def _draw_faces(start: int, stop: int, hidden: Any) -> None:
    """Draws some faces of the bound piece without the side `hidden`. With None both sides are drawn, for furniture is
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


def describe() -> str:
    """Driver and libraries of the current context."""
    driver = GL.glGetString(GL.GL_RENDERER).decode()
    return (
        f"{driver}; OpenGL {GL.glGetString(GL.GL_VERSION).decode()}; float32, 4 samples; "
        f"pyrender-maintained {version('pyrender-maintained')}; PyOpenGL {version('PyOpenGL')}"
    )
