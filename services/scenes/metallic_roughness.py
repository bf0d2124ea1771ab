"""Gives meshes the metallic-roughness surface that a scene's description asks for, in place of their own."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from services.scenes.mesh import AlphaMode, MapName, Mesh, MetallicRoughness, Part, TextureMap

METALLIC, ROUGHNESS = 0.0, 0.5
"""What a surface has of the two if only the other is given."""
REPEAT = (10497, 10497)
"""OpenGL's wrap modes of a texture that repeats, as those of files without sampler settings do."""
HALF = 128
"""Texels of less alpha are holes."""


def with_surface(mesh: Mesh, metallic: float | None, roughness: float | None) -> Mesh:
    """Returns the mesh with this metallic and roughness, both in [0,1], at every point; itself if both are None.

    Base colours, textures and opacities stay. A glTF material keeps its other settings and loses the map that varied
    the two. Other surfaces become glTF materials that are seen from both sides, as they were.
    """
    if metallic is None and roughness is None:
        return mesh
    given = METALLIC if metallic is None else metallic, ROUGHNESS if roughness is None else roughness
    return replace(mesh, parts=tuple(with_surface_of_part(part, *given) for part in mesh.parts))


def with_surface_of_part(part: Part, metallic: float, roughness: float) -> Part:
    """`with_surface` for one part of a mesh."""
    own = part.metallic_roughness
    if own is not None:
        maps: dict[MapName, TextureMap] = {k: one for k, one in own.maps.items() if k != "metallic_roughness"}
        return replace(
            part, metallic_roughness=replace(own, metallic=metallic, roughness=roughness, maps=maps, given=True)
        )
    count = len(part.vertices)
    return replace(
        part,
        uv=np.zeros((count, 2), np.float32) if part.uv is None else part.uv,
        texture=None,
        metallic_roughness=MetallicRoughness(
            metallic=metallic,
            roughness=roughness,
            emissive=(0.0, 0.0, 0.0),
            alpha_mode=_alpha_mode(part),
            alpha_cutoff=0.5,
            double_sided=True,
            normal_scale=1.0,
            occlusion_strength=1.0,
            maps=_maps(part),
            tangents=np.zeros((count, 4), np.float32),
            second_uv=np.zeros((count, 2), np.float32),
            vertex_colors=np.ones((count, 4), np.float32),
            given=True,
        ),
    )


def _maps(part: Part) -> Mapping[MapName, TextureMap]:
    if part.texture is None or part.uv is None:
        return {}
    texels, mode = part.texture, _alpha_mode(part)
    if mode == "BLEND":  # whose opacity would be multiplied by the texels'
        texels = texels.copy()
        texels[..., 3] = np.where(texels[..., 3] < HALF, 0, 255)
    return {"base_color": TextureMap(texels, 0, REPEAT)}


def _alpha_mode(part: Part) -> AlphaMode:
    if part.color[3] < 1:
        return "BLEND"
    holes = part.texture is not None and part.uv is not None and bool((part.texture[..., 3] < HALF).any())
    return "MASK" if holes else "OPAQUE"
