"""Compiled shaders. Imports OpenGL, so import it only through `context.current()`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from OpenGL import GL
from pyrender.shader_program import ShaderProgram

SHADERS = Path(__file__).parent / "shaders"
JOINED = {"METALLIC_ROUGHNESS": "metallic_roughness.frag", "SHADOWS": "shadows.frag"}
"""Files that are joined behind `surface.frag` where a constant is 1."""
EXTENSIONS = ("shading_language_420pack", "texture_gather")
"""What `shadows.frag` needs beyond OpenGL 3.3."""


class Program(ShaderProgram):  # type: ignore[misc]
    """A compiled shader program that refuses a uniform it does not have.

    `constants` are the numbers it is compiled for (`surface.vert` lists them): a loop over as many lights as there are,
    and no look at a texture where there is none, halve the time of a frame.
    """

    def __init__(self, fragment: str, constants: Mapping[str, int]) -> None:
        self._joined = [name for constant, name in JOINED.items() if constants[constant]]
        needed = "".join(f"#extension GL_ARB_{name} : require\n" for name in EXTENSIONS) * constants["SHADOWS"]
        self._head = needed + "".join(f"#define {name} {value}\n" for name, value in constants.items())
        super().__init__(str(SHADERS / "surface.vert"), str(SHADERS / fragment))
        self._locations: dict[str, int] = {}
        self._add_to_context()

    def _load(self, path: str) -> str:
        whole = Path(path).read_text()
        if path.endswith(".frag"):
            whole = "".join((SHADERS / name).read_text() for name in ("surface.frag", *self._joined)) + whole
        version, rest = whole.split("\n", 1)
        return f"{version}\n{self._head}{rest}"

    def has(self, name: str) -> bool:
        """Whether the linked program uses a uniform."""
        if name not in self._locations:
            self._locations[name] = GL.glGetUniformLocation(self._program_id, name)
        return self._locations[name] >= 0

    def set(self, name: str, value: Any) -> None:
        """Set a float or int, a vector, a 3x3 or 4x4 matrix, or an array of floats or of vectors ("name[0]").

        Raises KeyError for a uniform the linked program does not use.
        """
        if not self.has(name):
            raise KeyError(f"{Path(self.fragment_shader).name} has no uniform {name!r}")
        location = self._locations[name]
        if isinstance(value, int):
            GL.glUniform1i(location, value)
        elif isinstance(value, float):
            GL.glUniform1f(location, value)
        else:
            with np.errstate(over="ignore"):  # becomes infinite, and the image is refused for it
                value = np.ascontiguousarray(value, dtype=np.float32)
            if name.endswith("[0]"):
                (GL.glUniform1fv if value.ndim == 1 else GL.glUniform3fv)(location, len(value), value)
            elif value.ndim == 1:
                (GL.glUniform3fv if len(value) == 3 else GL.glUniform4fv)(location, 1, value)
            else:
                setter = GL.glUniformMatrix3fv if len(value) == 3 else GL.glUniformMatrix4fv
                setter(location, 1, GL.GL_TRUE, value)
