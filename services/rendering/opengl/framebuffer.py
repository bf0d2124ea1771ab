"""Floating-point framebuffers. Imports OpenGL, so import it only through `context.current()`."""

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL

from services.rendering.opengl.screen_bounds import Rectangle


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
        """A rectangle of the first `outputs` images, [outputs, rows, columns, 4]; the first row is the bottom one."""
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
        """Where in a pixel its samples are, [samples, 2], x and y from the lower left corner."""
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._draw)
        found = [np.zeros(2, np.float32) for _ in range(self.samples)]
        for i, position in enumerate(found):
            GL.glGetMultisamplefv(GL.GL_SAMPLE_POSITION, i, position)
        return np.array(found, np.float64)

    def delete(self) -> None:
        """Give the memory back."""
        GL.glDeleteFramebuffers(len(self._frames), self._frames)
        GL.glDeleteRenderbuffers(len(self._buffers), self._buffers)
