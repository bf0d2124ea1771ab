"""A sphere under a torch renderer, and values near its initial ones."""

import torch

from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN, MATERIAL_UNIT
from scene_attack.rendering.torch.renderer import TorchRenderer
from tests.unit.rendering.shading import sphere_gbuffer, sphere_scene

GROUPS = ("normals", "illumination", "illumination_rgb", "material", "bump", "dials", "paint", "lamp")
TWO = ("plastic", "brushed-metal")
TIGHT = 1e-4
"""Pixel by pixel in float32: no table for so few pixels holds this."""


def sphere(size=(12, 12), tolerance="exact", environment=None, materials=TWO, albedo=(0.3, 0.25, 0.2)) -> TorchRenderer:
    """Dark enough (by its albedo) that nothing is clipped."""
    scene = sphere_scene(size, environment, materials)
    return TorchRenderer(scene, sphere_gbuffer(scene, albedo=albedo), GROUPS, tolerance)


def moved(renderer: TorchRenderer, seed: int = 0, batch: int = 1) -> Parameters:
    """The initial values and something of every group on top, [batch, …]."""
    rng = torch.Generator().manual_seed(seed)
    light = 0.02 * ILLUMINATION_MEAN
    sizes = {"normals": 0.05, "illumination": light, "illumination_rgb": light, "material": 0.03 * MATERIAL_UNIT}
    sizes |= {"bump": 2.0, "dials": 0.3, "paint": 0.2, "lamp": 0.1}
    initial = renderer.initial()
    return {
        group: initial[group]
        + sizes[group]
        * torch.randn(batch, *initial[group].shape, generator=rng, dtype=torch.float64).to(initial[group])
        for group in GROUPS
    }
