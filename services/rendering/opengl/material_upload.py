"""glTF materials as OpenGL holds them. Imports OpenGL, so import it only through `context.current()`."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from OpenGL import GL
from pyrender.material import MetallicRoughnessMaterial
from pyrender.primitive import Primitive

from services.rendering.opengl.program import Program
from services.rendering.opengl.textures import LinearTexture, SrgbTexture
from services.scenes.mesh import Integers, MapName, MetallicRoughness, Part, TextureMap

NO_MATERIAL = {"METALLIC_ROUGHNESS": 0}
"""Constants of `Program` for surfaces without a glTF material."""

_SRGB = ("base_color", "emissive")
_MODES = {"OPAQUE": 0, "MASK": 1, "BLEND": 2}
_NAMES: tuple[MapName, ...] = ("base_color", "metallic_roughness", "normal", "occlusion", "emissive")

Textures = dict[tuple[int, bool, tuple[int, int]], LinearTexture]
"""Uploaded once each: by the array of texels, whether it is sRGB, and how it wraps."""


@dataclass(frozen=True, eq=False)
class UploadedMaterial:
    """A material, its textures and the constants of `Program` that draw it."""

    material: MetallicRoughness
    opacity: float
    textures: Mapping[MapName, LinearTexture]

    @property
    def constants(self) -> dict[str, int]:
        """See `metallic_roughness.frag`."""
        maps = self.material.maps
        sets = {f"{name.upper()}_MAP": maps[name].uv_set + 1 if name in maps else 0 for name in _NAMES}
        kind = {"ALPHA_MODE": _MODES[self.material.alpha_mode], "GIVEN": int(self.material.given)}
        return {"METALLIC_ROUGHNESS": 1, **kind, **sets}

    def bind(self, program: Program) -> None:
        """Set the uniforms that the program uses, and bind the textures."""
        m = self.material
        values = {
            "opacity": self.opacity,
            "metallic": m.metallic,
            "roughness": m.roughness,
            "emissive": np.array(m.emissive),
            "alpha_cutoff": m.alpha_cutoff,
            "normal_scale": m.normal_scale,
            "occlusion_strength": m.occlusion_strength,
        }
        for name, value in values.items():
            if program.has(name):
                program.set(name, value)
        for unit, (name, texture) in enumerate(self.textures.items()):
            if program.has(f"{name}_map"):
                program.set(f"{name}_map", unit)
                GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
                texture._bind()
        GL.glActiveTexture(GL.GL_TEXTURE0)


def upload_material(
    part: Part, material: MetallicRoughness, faces: Integers, textures: Textures
) -> tuple[Primitive, UploadedMaterial]:
    """The primitive of a part with a glTF material, with all vertex attributes of `surface.vert`, and the material."""
    held = {name: _texture(name, one, textures) for name, one in material.maps.items()}
    primitive = Primitive(
        positions=part.vertices,
        normals=part.normals,
        tangents=material.tangents,
        texcoord_0=part.uv,
        texcoord_1=material.second_uv,
        color_0=material.vertex_colors,
        indices=faces,
        # For pyrender, which uploads the textures of a primitive's material.
        material=MetallicRoughnessMaterial(
            baseColorTexture=held.get("base_color"),
            metallicRoughnessTexture=held.get("metallic_roughness"),
            normalTexture=held.get("normal"),
            occlusionTexture=held.get("occlusion"),
            emissiveTexture=held.get("emissive"),
        ),
    )
    return primitive, UploadedMaterial(material, float(part.color[3]), held)


def _texture(name: MapName, one: TextureMap, textures: Textures) -> LinearTexture:
    srgb = name in _SRGB
    key = id(one.texels), srgb, one.wrap
    if key not in textures:
        textures[key] = (SrgbTexture if srgb else LinearTexture)(source=one.texels, source_channels="RGBA")
        textures[key].wrap = one.wrap
    return textures[key]
