"""Textures as OpenGL holds them. Imports OpenGL, so import it only through `context.current()`."""

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.texture import Texture

from services.scenes.image_file import to_linear

LINEAR = to_linear(np.arange(256) / 255).astype(np.float32)
"""The linear value of each 8-bit sRGB value."""


class LinearTexture(Texture):  # type: ignore[misc]
    """An RGBA texture with mipmaps; `wrap`: OpenGL's modes for u and v."""

    _format = GL.GL_RGBA8
    wrap: tuple[int, int] = (GL.GL_REPEAT, GL.GL_REPEAT)

    def _add_to_context(self) -> None:
        height, width = self.source.shape[:2]
        self._texid = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
        # OpenGL's first row is v = 0, the bottom of the image.
        rows = np.ascontiguousarray(self.source[::-1])
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, self._format, width, height, 0, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, rows)
        GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_S, self.wrap[0])
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_T, self.wrap[1])
        GL.glBindTexture(GL.GL_TEXTURE_2D, 0)


class SrgbTexture(LinearTexture):
    """A texture in sRGB, decoded to linear before it is filtered (pyrender's are filtered as they are stored)."""

    _format = GL.GL_SRGB8_ALPHA8
    _levels: list[NDArray[np.float32]] | None = None

    def levels(self) -> list[NDArray[np.float32]]:
        """The driver's mipmaps, once uploaded: each [height, width, 4], linear red, green and blue, and alpha, all in
        [0,1], with its first row at v = 0."""
        if self._levels is None:
            self._levels = []
            GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
            GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
            size = np.array(self.source.shape[:2])
            for level in range(int(size.max()).bit_length()):
                texels = np.empty((*np.maximum(size >> level, 1), 4), np.uint8)
                GL.glGetTexImage(GL.GL_TEXTURE_2D, level, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, array=texels)
                linear = LINEAR[texels]
                linear[..., 3] = texels[..., 3] / np.float32(255)
                self._levels.append(linear)
            GL.glBindTexture(GL.GL_TEXTURE_2D, 0)
        return self._levels
