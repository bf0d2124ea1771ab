"""Renderers of a sphere with a plan, parameters around their initial values, and the error against the exact sum."""

from typing import Any

import numpy as np
import torch

from scene_attack.rendering.plan import Tolerance
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN
from scene_attack.rendering.torch.renderer import TorchRenderer
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene

GROUPS = ("normals", "illumination", "material")


def on_sphere(
    groups: tuple[str, ...] = GROUPS, tolerance: Tolerance = 1e-3, size: int = 64, **scene: Any
) -> TorchRenderer:
    """A renderer of a sphere of brushed metal under a map of 16 × 32 texels; `scene` overrides either."""
    given = {"materials": ("brushed-metal",), "environment": studio_map()} | scene
    resolved = sphere_scene((size, size), **given)
    return TorchRenderer(resolved, sphere_gbuffer(resolved), groups, tolerance)


def studio_map(rows: int = 16, cols: int = 32) -> np.ndarray:
    """A map float32 [rows, cols, 3] of soft light with two bright patches."""
    environment = 0.3 + 0.2 * sky(rows, cols)
    environment[rows // 4 : rows // 4 + 2, 1:4] = 20
    environment[rows // 3, cols // 2] = 8
    return environment.astype(np.float32)


def moved(renderer: TorchRenderer, groups: tuple[str, ...], far: float = 1.0, seed: int = 0) -> Parameters:
    """Initial values of the groups, [1, ...] each, plus steps of equal size with random signs, within the bounds."""
    random = torch.Generator().manual_seed(seed)
    light = 0.1 * ILLUMINATION_MEAN
    size = {"normals": 0.1, "illumination": light, "illumination_rgb": light, "material": 1.0, "bump": 3.0}
    size |= {"dials": 1.0, "paint": 1.0, "lamp": 0.5}
    start = renderer.initial()
    parameters = {}
    for group in groups:
        sign = (torch.rand(start[group].shape, generator=random) - 0.5).sign()
        low, high = renderer.bounds()[group]
        parameters[group] = (start[group] + far * size[group] * sign).clamp(low, high)[None]
    return parameters


@torch.no_grad()
def error(renderer: TorchRenderer, parameters: Parameters) -> float:
    """The largest absolute difference from the exact image in float64."""
    wide = {group: value.double() for group, value in parameters.items()}
    return float((renderer.render(parameters).double() - renderer.exact().render(wide)).abs().max())
