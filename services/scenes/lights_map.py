"""The environment map `lights`: a scene's own lights as the origin sees them, for the renderer that is lit by a map.

Each light is a round spot (a von Mises-Fisher distribution, the sphere's normal distribution) in its direction, whose
irradiance at the origin is the light's; between them is the ambient light, (1 + y/2) times as bright as its mean. The
spots are as wide as the texels of the default map, so that sums over texels are near the integral: a point light would
be a single texel, which moves by half its width when the map is made coarser.
"""

import hashlib
from math import cos, exp, pi

import numpy as np

from services.scenes.description import Lights
from services.scenes.environment import EnvironmentMap
from services.scenes.mesh import Doubles

NAME = "lights"
ROWS = 128
"""Rows of the map; it has twice as many columns."""
WIDTH = 0.15
"""Standard deviation of a light's spot, radians (8.6°)."""
VERSION = "lights 1"
"""Changes when the same lights give another map: it stands for the map in a scene's digest."""


def lights_map(lights: Lights) -> EnvironmentMap:
    """Returns the map of `lights`, [ROWS, 2 ROWS, 3], white.

    A light at the origin itself, and a spot light whose cone misses it, are left out.
    """
    polar = (np.arange(ROWS) + 0.5) * (pi / ROWS)
    azimuth = (np.arange(2 * ROWS) + 0.5) * (pi / ROWS)
    theta, phi = np.meshgrid(polar, azimuth, indexing="ij")
    directions = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=-1)
    radiance = lights.ambient * (1 + directions[..., 1] / 2)
    for towards, irradiance in _seen_from_the_origin(lights):
        radiance += irradiance * _spot(directions @ towards)
    values = np.repeat(radiance[..., None], 3, axis=-1).astype(np.float32)
    return EnvironmentMap(NAME, values, hashlib.sha256(VERSION.encode()).hexdigest(), credit=None)


def _seen_from_the_origin(lights: Lights) -> list[tuple[Doubles, float]]:
    """Returns each light's direction, a unit vector, and its irradiance on a surface that faces it."""
    found = []
    for point in lights.points:
        found.append((np.array(point.position, float), point.energy))
    for spot in lights.spots:
        place, axis = np.array(spot.position, float), np.array(spot.direction, float)
        distance = np.linalg.norm(place)
        if distance > 0:
            cosine = float(-(place @ axis) / (distance * np.linalg.norm(axis)))
            inner, outer = cos(spot.inner_angle), cos(spot.outer_angle)
            share = min(1.0, max(0.0, (cosine - outer) / max(inner - outer, 1e-9)))
            found.append((place, spot.energy * share**2))
    near = [(place / np.linalg.norm(place), energy / float(place @ place)) for place, energy in found if place.any()]
    far = [(-np.array(one.direction, float), one.energy) for one in lights.directional]
    return near + [(towards / np.linalg.norm(towards), energy) for towards, energy in far]


def _spot(cosine: Doubles) -> Doubles:
    """Returns the density of the spot at cosines of the angle to its middle; its integral over the sphere is 1."""
    kappa = 1 / WIDTH**2
    density: Doubles = kappa / (2 * pi * (1 - exp(-2 * kappa))) * np.exp(kappa * (cosine - 1))
    return density
