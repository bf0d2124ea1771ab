"""Shadow maps: the depth of a scene's objects as its lights see it. Imports OpenGL, so import it only through
`context.current()`.

Maps are kept until objects move or the texture is full: a light that stays where it was is not drawn again.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from scipy.ndimage import minimum_filter

from scene_attack.rendering.opengl.camera import beyond
from scene_attack.rendering.opengl.mesh_upload import Drawing, Piece, Program
from scene_attack.rendering.opengl.shadows import PassShadows, ShadowView, box_corners, casters, shadow_views

Array = NDArray[np.float64]

UNITS = (13, 14, 15)
"""Texture units of the depths, their least values and the views, behind those of materials."""
BLOCK = 8
"""Side, in texels, of a block. The least depth of each block is stored, so that a fragment far from any shadow takes a
single look-up."""
FEWEST_LAYERS = 16
"""Minimum number of layers of the texture."""


class ShadowMaps:
    """The maps that were drawn last, as layers of one texture, and the views that they were drawn from."""

    def __init__(self, program: Callable[[Piece], Program]) -> None:
        """`program` gives the program that draws a piece's depth."""
        self._program = program
        self._frame = int(GL.glGenFramebuffers(1))
        self._depths, self._least, self._views = (int(name) for name in GL.glGenTextures(3))
        self._resolution, self._layers = 0, 0
        self._drawing: Drawing | None = None
        self._poses: Array = np.zeros(0)
        self._corners: tuple[list[Array], list[bool]] = ([], [])
        self._rows: list[Array] = []
        self._maps: dict[bytes, tuple[int, int, float]] = {}
        """For each light its first layer, the number of its layers, and its radius, an angle if its view is
        parallel."""

    def uniforms(self, drawing: Drawing, poses: Array, shadows: PassShadows) -> dict[str, Any]:
        """Draws the maps that are missing and binds all; returns the uniforms of `shadows.frag`.

        `poses` [objects, 4, 4] are world from object. The drawing's geometry has been uploaded.
        """
        if drawing is not self._drawing:
            self._drawing, self._corners, self._maps = drawing, box_corners(drawing.points), {}
        if shadows.resolution != self._resolution or not np.array_equal(poses, self._poses):
            self._maps = {}
        self._poses = poses
        self._draw(shadows)
        array, plain = GL.GL_TEXTURE_2D_ARRAY, GL.GL_TEXTURE_2D
        bound = ((array, self._depths), (array, self._least), (plain, self._views))
        for unit, (kind, texture) in zip(UNITS, bound, strict=True):
            GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
            GL.glBindTexture(kind, texture)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        maps = np.zeros((len(shadows.of), 3))
        for k, key in enumerate(shadows.keys):
            maps[k] = self._maps[key]
        return {
            "shadow_lights": len(shadows.lights),
            "shadow_maps[0]": maps,
            "shadow_of[0]": shadows.of.astype(np.float64),
            "shadow_samples": shadows.samples,
        }

    def _draw(self, shadows: PassShadows) -> None:
        """Draws the maps of the lights that have none."""
        assert self._drawing is not None
        corners = [own @ pose[:3, :3].T + pose[:3, 3] for own, pose in zip(self._corners[0], self._poses, strict=True)]
        views = {}
        for key, light, radius in zip(shadows.keys, shadows.lights, shadows.radii, strict=True):
            own = casters(corners, self._corners[1], light)
            views[key] = radius, own, shadow_views([corners[k] for k in own], light)
        missing = [key for key in views if key not in self._maps]
        if not missing:
            return
        if not self._maps:
            self._rows = []
        n_new = sum(len(views[key][2]) for key in missing)
        if shadows.resolution != self._resolution or len(self._rows) + n_new > self._layers:
            self._maps, self._rows, missing = {}, [], list(views)
            n_new = sum(len(seen) for _, _, seen in views.values())
            # as many layers as before, of the same size: other maps may be so large that as many have no place
            fewest = self._layers if shadows.resolution == self._resolution else FEWEST_LAYERS
            self._allocate(shadows.resolution, max(n_new, fewest))
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glDrawBuffer(GL.GL_NONE)
        GL.glReadBuffer(GL.GL_NONE)
        GL.glViewport(0, 0, shadows.resolution, shadows.resolution)
        for name in (GL.GL_CULL_FACE, GL.GL_BLEND, GL.GL_MULTISAMPLE):
            GL.glDisable(name)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glDepthMask(GL.GL_TRUE)
        for key in missing:
            radius, own, seen = views[key]
            radius = radius / seen[0].distance if seen else radius
            self._maps[key] = len(self._rows), len(seen), radius
            for view in seen:
                self._layer(len(self._rows), view, {k: corners[k] for k in own})
                reach = self._summarise(len(self._rows), view.spread(radius))
                self._rows.append(np.vstack([view.row, (reach, 0, 0, 0)]))
        if self._rows:
            rows = np.ascontiguousarray(self._rows, np.float32)
            GL.glBindTexture(GL.GL_TEXTURE_2D, self._views)
            GL.glTexSubImage2D(GL.GL_TEXTURE_2D, 0, 0, 0, 5, len(rows), GL.GL_RGBA, GL.GL_FLOAT, rows)
            GL.glBindTexture(GL.GL_TEXTURE_2D, 0)

    def _layer(self, layer: int, view: ShadowView, corners: dict[int, Array]) -> None:
        """Draws the depth of those objects, by index with their corners, that may be in the view."""
        assert self._drawing is not None
        GL.glFramebufferTextureLayer(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, self._depths, 0, layer)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        camera = view.camera
        of_objects = camera.matrices(self._poses)
        ends = {k: np.column_stack([own, np.ones(8)]).T for k, own in corners.items()}
        shown = [k for k, own in ends.items() if not beyond(own, camera.clip_from_world, 0.0)]
        for piece in self._drawing.pieces:
            if not piece.solid or piece.index not in shown:
                continue
            program = self._program(piece)
            program._bind()
            values = of_objects[piece.index] | {"eye": view.origin, "forward": view.axes[2], "far": float(view.far)}
            for name, value in values.items():
                if program.has(name):
                    program.set(name, value)
            if piece.holes and piece.texture is not None:
                program.set("base_color_texture", 0)
                piece.texture._bind()
            if piece.material is not None:
                piece.material.bind(program)
            piece.primitive._bind()
            GL.glDrawElements(GL.GL_TRIANGLES, 3 * piece.faces, GL.GL_UNSIGNED_INT, None)
        GL.glBindVertexArray(0)

    def _summarise(self, layer: int, spread: float) -> float:
        """Stores the least depth around each block of the layer just drawn, as far as the samples of a soft shadow may
        look, `spread`, as a share of the map's half width; returns how far that is, counted likewise.
        """
        side = self._resolution
        depths = np.empty((side, side), np.float32)
        GL.glReadPixels(0, 0, side, side, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, array=depths)
        rows = depths.reshape(side // BLOCK, BLOCK, side).min(axis=1)  # one axis at a time: numpy is slow at both
        blocks = rows.reshape(side // BLOCK, side // BLOCK, BLOCK).min(axis=2)
        n_around = min(int(np.ceil((spread * side / 2 + 2) / BLOCK)), len(blocks))
        least = np.ascontiguousarray(minimum_filter(blocks, 2 * n_around + 1, mode="nearest"))
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, self._least)
        place = (0, 0, layer, *least.shape, 1)
        GL.glTexSubImage3D(GL.GL_TEXTURE_2D_ARRAY, 0, *place, GL.GL_RED, GL.GL_FLOAT, least)
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, 0)
        return (n_around + 1) * BLOCK * 2 / side

    def _allocate(self, resolution: int, layers: int) -> None:
        self._resolution, self._layers = resolution, layers
        kind, side = GL.GL_TEXTURE_2D_ARRAY, resolution
        GL.glBindTexture(kind, self._depths)
        depth = (GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, None)
        GL.glTexImage3D(kind, 0, GL.GL_DEPTH_COMPONENT32F, side, side, layers, 0, *depth)
        _unfiltered(kind)
        GL.glBindTexture(kind, self._least)
        side //= BLOCK
        GL.glTexImage3D(kind, 0, GL.GL_R32F, side, side, layers, 0, GL.GL_RED, GL.GL_FLOAT, None)
        _unfiltered(kind)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._views)
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA32F, 5, layers, 0, GL.GL_RGBA, GL.GL_FLOAT, None)
        _unfiltered(GL.GL_TEXTURE_2D)


def _unfiltered(kind: Any) -> None:
    GL.glTexParameteri(kind, GL.GL_TEXTURE_MIN_FILTER, GL.GL_NEAREST)
    GL.glTexParameteri(kind, GL.GL_TEXTURE_MAG_FILTER, GL.GL_NEAREST)
    GL.glBindTexture(kind, 0)
