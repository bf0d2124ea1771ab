"""Looks: light and surface of a view, as tables of radiance over the normals of the camera's frame.

The displayed value of a pixel is the sRGB curve of base colour · body(n) + gloss(n). Half of the looks are the torch
renderer's (an environment map on one of the material presets), the other half the pyrender renderer's (ambient light
and lamps on a coated Lambertian body, the lamps taken as far away). Both include each renderer's default light.
"""

from dataclasses import dataclass
from math import exp, pi

import numpy as np
import torch
from torch import Tensor

from scene_attack.rendering.torch import dsbrdf
from scene_attack.rendering.torch.dsbrdf import MATERIAL_UNIT, colored_lobes, presets
from scene_attack.rendering.torch.light import illumination
from scene_attack.rendering.torch.renderer import sky_of
from scene_attack.rendering.torch.shading import Lobes, radiance
from scene_attack.scenes.description import ELEVATION, Camera, Environment, Lights
from scene_attack.scenes.environment import average
from scene_attack.scenes.library import Library
from scene_attack.scenes.view import camera_to_world
from training.views import node_normals

EXPOSURE = 0.5
"""Exposure of the pyrender renderer."""
ROUGHNESS, NORMAL_REFLECTANCE = 0.45, 0.04
"""Roughness and reflectance at normal incidence of the pyrender renderer's coat."""
DEFAULTS = 0.2
"""Share of the looks that have a renderer's default light and material."""
MATTE = 0.6
"""Share of the other environment looks that have the preset "matte"."""


@dataclass(frozen=True)
class Lamp:
    """A distant light: unit vector towards it in the camera's frame [3], and the irradiance it gives."""

    towards: Tensor
    irradiance: float


def looks(library: Library, count: int, seed: int) -> Tensor:
    """Returns `count` looks, float32 [count, GRID², 6]: body RGB and gloss RGB at each node."""
    random = np.random.default_rng([seed, 1])
    maps = [entry.name for entry in library.environments()]
    return torch.stack([_environment(library, maps, random) if k % 2 else _lamps(random) for k in range(count)])


def default_looks(library: Library, turns: int) -> Tensor:
    """Returns each renderer's look of the default scene, seen from `turns` sides: float32 [2 · turns, GRID², 6]."""
    lamps = [lamps_look(Lights().ambient, [default_lamp(side, ELEVATION)], ELEVATION) for side in _sides(turns)]
    return torch.cat([environment_looks(library, turns, "matte"), torch.stack(lamps)])


def environment_looks(library: Library, turns: int, material: str) -> Tensor:
    """Returns the torch renderer's look of the default scene, of one material, seen from `turns` sides: float32
    [turns, GRID², 6]."""
    sides = _sides(turns)
    return torch.stack([environment_look(library, Environment(rotation=side), material, ELEVATION) for side in sides])


def _sides(turns: int) -> list[float]:
    return [2 * pi * k / turns - pi for k in range(turns)]


def environment_look(library: Library, light: Environment, material: str, elevation: float) -> Tensor:
    """Returns the torch renderer's look [GRID², 6] of a preset under a map, the camera at azimuth 0."""
    to_camera = torch.from_numpy(camera_to_world(Camera(azimuth=0.0, elevation=elevation))[:3, :3])
    radiance_map = average(library.environment(light.map).radiance, *light.texels, light.rotation)
    split = illumination(torch.as_tensor(radiance_map))
    sky = sky_of(split, to_camera)
    log_kappa, gamma = dsbrdf.lobes(presets()[material] * MATERIAL_UNIT, sky.curves)
    none = torch.zeros(dsbrdf.CHANNELS, log_kappa.shape[-1], dtype=torch.float64)
    light_of = sky.power * split.intensity.flatten()
    colored = torch.tensor(colored_lobes(material))
    chosen = [Lobes(none, none, log_kappa[:, own], gamma[:, own]) for own in (colored, ~colored)]
    return torch.cat([radiance(node_normals(), light_of, lobes, sky.directions) for lobes in chosen], -1).float()


def lamps_look(ambient: float, lamps: list[Lamp], elevation: float) -> Tensor:
    """Returns the pyrender renderer's look [GRID², 6] (`radiance.frag`) under ambient light and distant lamps."""
    normals = node_normals()
    viewer = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    up = torch.tensor([0.0, np.cos(elevation), np.sin(elevation)], dtype=torch.float64)
    facing = normals @ viewer
    body = ambient * (1 + normals @ up / 3)
    gloss = ambient * _fresnel(1 - ROUGHNESS, facing)
    for lamp in lamps:
        irradiance = lamp.irradiance * (normals @ lamp.towards).clamp_min(0.0)
        body = body + irradiance / pi
        gloss = gloss + irradiance * _coat(normals, viewer, lamp.towards)
    return (EXPOSURE * torch.stack((body, gloss), 1)).repeat_interleave(3, 1).float()


def default_lamp(azimuth: float, elevation: float) -> Lamp:
    """Returns the default point light as seen by a camera at that azimuth and elevation."""
    point = Lights().points[0]
    to_camera = camera_to_world(Camera(azimuth=azimuth, elevation=elevation))[:3, :3]
    place = torch.from_numpy(np.array(point.position) @ to_camera)
    distance = float(place.norm())
    return Lamp(place / distance, point.energy / distance**2)


def _environment(library: Library, maps: list[str], random: np.random.Generator) -> Tensor:
    turn, elevation = random.uniform(-pi, pi), ELEVATION + random.uniform(-0.17, 0.17)
    if random.random() < DEFAULTS:
        return environment_look(library, Environment(rotation=turn), "matte", elevation)
    material = "matte" if random.random() < MATTE else str(random.choice(list(presets())))
    light = Environment(map=str(random.choice(maps)), rotation=turn)
    return environment_look(library, light, material, elevation) * exp(random.uniform(-0.4, 0.25))


def _lamps(random: np.random.Generator) -> Tensor:
    elevation = ELEVATION + random.uniform(-0.17, 0.17)
    if random.random() < DEFAULTS:
        return lamps_look(Lights().ambient, [default_lamp(random.uniform(-pi, pi), elevation)], elevation)
    lamps = []
    for _ in range(1 + int(random.random() < 0.3)):
        azimuth, height = random.uniform(-pi, pi), random.uniform(0.2, 1.4)
        lamp = default_lamp(0.0, elevation)
        up = np.array([0.0, np.cos(elevation), np.sin(elevation)])
        ahead = np.array([0.0, -np.sin(elevation), np.cos(elevation)])
        across = np.sin(azimuth) * np.array([1.0, 0.0, 0.0]) + np.cos(azimuth) * ahead
        towards = torch.from_numpy(np.cos(height) * across + np.sin(height) * up)
        lamps.append(Lamp(towards, lamp.irradiance * exp(random.uniform(-0.8, 0.4))))
    return lamps_look(Lights().ambient * exp(random.uniform(-0.8, 0.7)), lamps, elevation)


def _fresnel(grazing: float, cosine: Tensor) -> Tensor:
    return NORMAL_REFLECTANCE + (grazing - NORMAL_REFLECTANCE) * (1 - cosine.clamp(0, 1)) ** 5


def _coat(normals: Tensor, viewer: Tensor, towards: Tensor) -> Tensor:
    a2 = ROUGHNESS**4
    half = torch.nn.functional.normalize(towards + viewer, dim=0)
    nh, nl = (normals @ half).clamp_min(0.0), (normals @ towards).clamp_min(0.0)
    nv = (normals @ viewer).clamp_min(1e-4)
    distribution = a2 / (pi * (nh * nh * (a2 - 1) + 1) ** 2)
    masked = nl * (nv * nv * (1 - a2) + a2).sqrt() + nv * (nl * nl * (1 - a2) + a2).sqrt()
    return distribution * 0.5 / masked.clamp_min(1e-12) * _fresnel(1.0, (viewer @ half).expand_as(nh))
