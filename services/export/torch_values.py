"""What the torch renderer's groups are before and after an attack: its light as a map, and its normals as vectors."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from services.rendering.opengl.gbuffer import rasterise
from services.rendering.protocol import Parameters
from services.rendering.torch_renderer.light import illumination
from services.rendering.torch_renderer.surfaces import visible_surfaces
from services.rendering.torch_renderer.table import to_vectors
from services.scenes.mesh import Bytes, Floats
from services.scenes.resolve import ResolvedScene


@dataclass(frozen=True)
class BeforeAfter:
    """An array before and after an attack."""

    before: Floats
    after: Floats


def light_maps(scene: ResolvedScene, perturbation: Parameters) -> BeforeAfter:
    """The radiance [rows, cols, 3] of the map's texels after the exposure, in linear display units, float32."""
    light = illumination(torch.as_tensor(scene.environment))

    def radiance(intensity: Tensor) -> Floats:
        found = light.exposure * light.chroma * intensity.clamp_min(0.0)
        return np.asarray(found.numpy(), np.float32)

    own = light.intensity[..., None]
    moved = own
    if "illumination" in perturbation:
        moved = moved + perturbation["illumination"].double()[..., None]
    if "illumination_rgb" in perturbation:
        moved = moved + perturbation["illumination_rgb"].double()
    return BeforeAfter(radiance(own), radiance(moved))


def normal_maps(scene: ResolvedScene, perturbation: Parameters) -> BeforeAfter:
    """The unit normals [H, W, 3] that the pixels are shaded by, in the camera's frame (+x right, +y up, +z towards the
    viewer), float32; 0 where nothing is. Draws with OpenGL."""
    gbuffer = rasterise(scene)
    to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3]
    angles = visible_surfaces(gbuffer, to_camera).image
    seen = (gbuffer.coverage > 0)[..., None]

    def vectors(of: Tensor) -> Floats:
        return np.asarray((to_vectors(of.double()) * seen).numpy(), np.float32)

    change = perturbation.get("normals")
    return BeforeAfter(vectors(angles), vectors(angles if change is None else angles + change.double()))


def as_colors(normals: Floats) -> Bytes:
    """Unit normals [H, W, 3] as an image: n / 2 + 1/2 of each axis, uint8; black where nothing is."""
    seen = (normals != 0).any(axis=-1, keepdims=True)
    return np.where(seen, np.rint((normals * 0.5 + 0.5) * 255), 0).astype(np.uint8)
