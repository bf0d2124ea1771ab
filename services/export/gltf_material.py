"""The glTF 2.0 material and vertex attributes of a part of a mesh.

glTF has one kind of surface. A surface that came with another one, the Lambertian body under a coat, is written as the
nearest glTF has, a dielectric of the coat's roughness, and `extras` name its own.
"""

from typing import Any

import numpy as np

from services.export.glb import INDICES, Glb
from services.scenes.mesh import Doubles, MapName, MetallicRoughness, Part
from services.scenes.resolve import with_surface_of_part

COAT_ROUGHNESS = 0.45
"""The roughness of the coat in `shaders/radiance.frag`."""
COAT, GLTF, GLTF_SMITH = "coat", "gltf", "gltf-smith"
"""What `extras.brdf` says of a material: the formula in `stock/mesh.frag` that gives the project's image."""


def primitive(glb: Glb, part: Part, factor: Doubles, exposure: float, name: str) -> dict[str, Any]:
    """The triangles of a part with its base colour times `factor` [3], linear RGB; emission times `exposure`."""
    own = part.metallic_roughness
    as_gltf = part if own is not None else with_surface_of_part(part, 0.0, COAT_ROUGHNESS)
    surface = as_gltf.metallic_roughness
    assert surface is not None
    brdf = COAT if own is None else GLTF_SMITH if own.given else GLTF
    attributes = {"POSITION": glb.accessor(part.vertices), "NORMAL": glb.accessor(part.normals)}
    if surface.maps and as_gltf.uv is not None:
        attributes["TEXCOORD_0"] = glb.accessor(_downwards(glb, as_gltf.uv))
    if any(one.uv_set for one in surface.maps.values()):
        attributes["TEXCOORD_1"] = glb.accessor(_downwards(glb, surface.second_uv))
    if "normal" in surface.maps:
        attributes["TANGENT"] = glb.accessor(surface.tangents)
    if not (surface.vertex_colors == 1).all():
        attributes["COLOR_0"] = glb.accessor(surface.vertex_colors)
    color = [*(factor * part.color[:3]).clip(0, 1).tolist(), float(part.color[3])]
    return {
        "attributes": attributes,
        "indices": glb.accessor(glb.kept(part.faces, lambda: part.faces.astype(np.uint32).ravel()), INDICES),
        "material": glb.add("materials", _material(glb, surface, color, exposure, brdf) | {"name": name}),
    }


def _downwards(glb: Glb, uv: Any) -> Any:
    """Texture coordinates [V, 2] with v downwards, as glTF has it."""
    return glb.kept(uv, lambda: np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype(np.float32))


def _material(glb: Glb, m: MetallicRoughness, color: list[float], exposure: float, brdf: str) -> dict[str, Any]:
    maps: dict[MapName, dict[str, Any]] = {
        name: {"index": glb.texture(one.texels, one.wrap), "texCoord": one.uv_set} for name, one in m.maps.items()
    }
    reflecting: dict[str, Any] = {
        "baseColorFactor": color,
        "metallicFactor": m.metallic,
        "roughnessFactor": m.roughness,
    }
    entry: dict[str, Any] = {
        "pbrMetallicRoughness": reflecting,
        "alphaMode": m.alpha_mode,
        "doubleSided": m.double_sided,
        "extras": {"brdf": brdf},
    }
    if m.alpha_mode == "MASK":
        entry["alphaCutoff"] = m.alpha_cutoff
    if "base_color" in maps:
        reflecting["baseColorTexture"] = maps["base_color"]
    if "metallic_roughness" in maps:
        reflecting["metallicRoughnessTexture"] = maps["metallic_roughness"]
    if "normal" in maps:
        entry["normalTexture"] = maps["normal"] | {"scale": m.normal_scale}
    if "occlusion" in maps:
        entry["occlusionTexture"] = maps["occlusion"] | {"strength": m.occlusion_strength}
    if "emissive" in maps:
        entry["emissiveTexture"] = maps["emissive"]
    emission = [exposure * one for one in m.emissive]
    if any(emission):
        strength = max(1.0, *emission)
        entry["emissiveFactor"] = [one / strength for one in emission]
        if strength > 1:
            glb.uses("KHR_materials_emissive_strength")
            entry["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
    return entry
