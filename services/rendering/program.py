"""Compiled shaders. Imports OpenGL, so import it only through `gl.context()`."""

from pathlib import Path
from typing import Any

import numpy as np
from OpenGL import GL
from pyrender.shader_program import ShaderProgram

SHADERS = Path(__file__).parent / "shaders"


class Program(ShaderProgram):  # type: ignore[misc]
    """A compiled shader program that refuses a uniform it does not have."""

    def __init__(self, fragment: str) -> None:
        super().__init__(str(SHADERS / "surface.vert"), str(SHADERS / fragment))
        self._locations: dict[str, int] = {}
        self._add_to_context()

    def _load(self, path: str) -> str:
        text = Path(path).read_text()
        return text if path.endswith(".vert") else (SHADERS / "surface.frag").read_text() + text

    def set(self, name: str, value: Any) -> None:
        """Set a float or int, a vector, a 3x3 or 4x4 matrix, or an array of floats or of vectors ("name[n]").

        Raises KeyError for a uniform the linked program does not use.
        """
        if name not in self._locations:
            location = GL.glGetUniformLocation(self._program_id, name)
            if location < 0:
                raise KeyError(f"{Path(self.fragment_shader).name} has no uniform {name!r}")
            self._locations[name] = location
        location = self._locations[name]
        if isinstance(value, int):
            GL.glUniform1i(location, value)
        elif isinstance(value, float):
            GL.glUniform1f(location, value)
        else:
            with np.errstate(over="ignore"):  # becomes infinite, and the picture is refused for it
                value = np.ascontiguousarray(value, dtype=np.float32)
            if name.endswith("[0]"):
                count, width = len(value), value.size // len(value)
                (GL.glUniform1fv if width == 1 else GL.glUniform3fv)(location, count, value)
            elif value.ndim == 1:
                (GL.glUniform3fv if len(value) == 3 else GL.glUniform4fv)(location, 1, value)
            else:
                setter = GL.glUniformMatrix3fv if len(value) == 3 else GL.glUniformMatrix4fv
                setter(location, 1, GL.GL_TRUE, value)
