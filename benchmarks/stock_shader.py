"""Stock pyrender's renderer with its shader put right, for `benchmarks.stock_meshes`: what a glTF file says of alpha,
backs and emission is drawn. Made alike to ours, it also decodes the texels of colours before they are averaged, and
puts normals that bend beyond the horizon on it.

The shader is pyrender's own, with these lines of it replaced. What is not named here is as it is installed.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyrender
from OpenGL import GL
from PIL import Image
from pyrender.renderer import Renderer
from pyrender.shader_program import ShaderProgramCache

CHANGES = (
    (
        "    // Compute specular and diffuse colors\n",
        # An opaque surface ignores alpha; a mask is opaque or not there.
        "#ifdef IS_MASK\n    if (base_color.a < 0.01 * IS_MASK) discard;\n#endif\n"
        "#ifndef IS_BLEND\n    base_color.a = 1.0;\n#endif\n",
    ),
    # The backs of double-sided faces turn their normals over.
    (
        "    vec3 n = normalize(get_normal());\n",
        "    vec3 n = normalize(get_normal()) * (gl_FrontFacing ? 1.0 : -1.0);\n"
        "#ifdef ON_HORIZON\n"
        "    vec3 to_eye = normalize(cam_pos - frag_position);\n"
        "    n = normalize(n - min(dot(n, to_eye), 0.0) * to_eye);\n"
        "#endif\n",
    ),
    # The emission is multiplied by its factor once.
    ("color.xyz += emissive * material.emissive_factor;", "color.xyz += emissive;"),
    # The occlusion map darkens the ambient light alone, and there is none.
    ("    color.xyz *= ao;\n", ""),
)
"""What is replaced in pyrender's fragment shader."""


class MendedRenderer(Renderer):  # type: ignore[misc]
    """pyrender's renderer, which draws materials with `alphaMode` and `alphaCutoff` as glTF means them."""

    def __init__(self) -> None:
        super().__init__(1, 1)
        self._program_cache = _Programs()
        self.alike = False
        """Whether horizons and texels are treated as ours are; the scene must have been through `decode`."""

    def _get_primitive_program(self, primitive: Any, flags: int, program_flags: int) -> Any:
        material = primitive.material
        self._program_cache.more = {"SRGB_CORRECTED": 1} if self.alike else {}
        if self.alike and material.normalTexture is None:
            self._program_cache.more["ON_HORIZON"] = 1
        if material.alphaMode == "BLEND":
            self._program_cache.more["IS_BLEND"] = 1
        elif material.alphaMode == "MASK":
            self._program_cache.more["IS_MASK"] = round(100 * material.alphaCutoff)
        return super()._get_primitive_program(primitive, flags, program_flags)


class _Programs(ShaderProgramCache):  # type: ignore[misc]
    """pyrender's programs, compiled from the changed shader for the constants `more` besides its own."""

    def __init__(self) -> None:
        super().__init__()
        self.more: dict[str, int] = {}
        self._folder = tempfile.TemporaryDirectory()
        for path in Path(self.shader_dir).iterdir():
            text = path.read_text()
            for old, new in CHANGES if path.name == "mesh.frag" else ():
                if text.count(old) != 1:
                    raise ValueError(f"pyrender's shader is another one: {old.strip()!r} is not in it once")
                text = text.replace(old, new)
            (Path(self._folder.name) / path.name).write_text(text)
        self.shader_dir = self._folder.name

    def get_program(
        self, vertex_shader: str, fragment_shader: str, geometry_shader: str | None = None, defines: Any = None
    ) -> Any:
        return super().get_program(vertex_shader, fragment_shader, geometry_shader, (defines or {}) | self.more)


def decode(scene: pyrender.Scene, largest: int) -> None:
    """Uploads the colour textures of a scene as sRGB, which OpenGL decodes before it averages texels, and all textures
    with at most `largest` texels a side."""
    for texture in {one for mesh in scene.meshes for each in mesh.primitives for one in each.material.textures}:
        small = Image.fromarray(texture.source)
        small.thumbnail((largest, largest), Image.Resampling.BOX)
        transparent, texture.source = texture._is_transparent, np.asarray(small)  # noqa: SLF001
        texture._is_transparent = transparent  # noqa: SLF001 - which the new texels have made it forget
    for material in (each.material for mesh in scene.meshes for each in mesh.primitives):
        for texture in (material.baseColorTexture, material.emissiveTexture):
            if texture is not None:
                texture.__class__ = _SrgbTexture


class _SrgbTexture(pyrender.Texture):  # type: ignore[misc]
    """A texture of pyrender's, with its own sampler, in sRGB."""

    def _add_to_context(self) -> None:
        super()._add_to_context()
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
        kinds = {"RGB": (GL.GL_SRGB8, GL.GL_RGB), "RGBA": (GL.GL_SRGB8_ALPHA8, GL.GL_RGBA)}
        stored, given = kinds[self.source_channels]
        rows = self.source[::-1].tobytes()  # OpenGL's first row is the bottom one
        height, width = self.source.shape[:2]
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, stored, width, height, 0, given, GL.GL_UNSIGNED_BYTE, rows)
        GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
        GL.glBindTexture(GL.GL_TEXTURE_2D, 0)
