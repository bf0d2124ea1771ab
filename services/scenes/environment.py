"""Environment maps: radiance from every direction, on a grid of polar angle and azimuth.

Everywhere in this project row i of a map of `rows` rows is the polar angle θ = (i + ½)π/rows from +y and column j of
`cols` columns the azimuth φ = (j + ½)2π/cols, measured about +y from +z towards +x: the direction
(sin θ sin φ, cos θ, sin θ cos φ).

Equirectangular image files have the opposite azimuth, as they show the sphere from inside: their top row is straight
up, their middle column is +x, and columns further right show +z, −x, −z (the convention of Blender and three.js, with
+y up). `from_image` converts them.

The map `lights` is a scene's own lights as the origin sees them, for the renderer that is lit by a map. Each light is a
round spot (a von Mises-Fisher distribution, the sphere's normal distribution) in its direction, whose irradiance at the
origin is the light's; between them is the ambient light, (1 + y/2) times as bright as its mean. The spots are as wide
as the texels of the default map, so that sums over texels are near the integral: a point light would be a single
texel, which moves by half its width when the map is made coarser.
"""

import hashlib
from dataclasses import dataclass
from math import cos, exp, pi
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from services.errors import InvalidRequest, JobFailure
from services.scenes.description import Lights
from services.scenes.mesh import Doubles, Floats


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """An environment map.

    radiance: linear RGB, float32 [rows, cols, 3], finite, ≥ 0, in this project's directions. sha256: the hex digest of
    the file. credit: the attribution line, or None.
    """

    name: str
    radiance: Floats
    sha256: str
    credit: str | None


def read_exr(path: Path, credit: str | None) -> EnvironmentMap:
    """Reads a map from an equirectangular OpenEXR image.

    Raises JobFailure("asset-missing") if the file cannot be read or has no colours, and the errors of `radiance_of`.
    """
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        with OpenEXR.File(str(path)) as file:
            channels = file.channels()
            if "RGBA" in channels or "RGB" in channels:
                pixels = np.asarray(channels["RGBA" if "RGBA" in channels else "RGB"].pixels)[..., :3]
            else:
                pixels = np.stack([np.asarray(channels[name].pixels) for name in "RGB"], axis=-1)
    except (OSError, KeyError, RuntimeError, ValueError) as error:
        raise JobFailure("asset-missing", f"cannot read the environment map {path.name}: {error}") from error
    return EnvironmentMap(name=path.stem, radiance=radiance_of(pixels), sha256=digest, credit=credit)


def uniform() -> EnvironmentMap:
    """Returns the map with radiance 1 in every direction."""
    radiance = np.ones((1, 4, 3), np.float32)
    return EnvironmentMap("uniform", radiance, hashlib.sha256(radiance.tobytes()).hexdigest(), credit=None)


def radiance_of(pixels: NDArray[Any]) -> Floats:
    """Converts the pixels [h,w,3] of an equirectangular file to radiance, float32, in this project's directions.

    Negative values, which filters leave beside bright spots, become 0. Raises InvalidRequest("environment", …) for
    values that are not finite: an overflowed value was bright, and its radiance is unknown.
    """
    values = np.asarray(pixels, np.float32)
    bad = int((~np.isfinite(values)).any(axis=-1).sum())
    if bad:
        raise InvalidRequest(
            "environment", f"{bad:,} of its texels are not finite numbers; write them as finite radiance"
        )
    return from_image(values.clip(min=0.0))


def from_image(image: Floats) -> Floats:
    """Converts an equirectangular image [h,w,3] to this project's directions (see the module's docstring)."""
    width = image.shape[1]
    mirrored = image[:, ::-1]
    # Image position u (0 left, 1 right) looks along the azimuth φ = 2π(¾ − u); mirrored, 1 − u comes first.
    if width % 4 == 0:
        return np.ascontiguousarray(np.roll(mirrored, -width // 4, axis=1))
    weights = _column_weights(width, width, -pi / 2)
    image64: Doubles = np.einsum("jw,hwc->hjc", weights, mirrored.astype(np.float64))
    return image64.astype(np.float32)


def average(radiance: Floats, rows: int, cols: int, rotation: float = 0.0) -> Floats:
    """Averages a map to `rows` × `cols` texels, turned about +y by `rotation` radians: float32 [rows, cols, 3].

    Every texel is the mean radiance over its solid angle, weighted by the solid angle shared with each source texel, so
    the integral over the sphere is the same for any grid. Positive rotations turn +z towards +x.
    """
    height, width = radiance.shape[:2]
    source = np.cos(np.linspace(0, pi, height + 1))
    target = np.cos(np.linspace(0, pi, rows + 1))
    shared = np.minimum(target[:-1, None], source[None, :-1]) - np.maximum(target[1:, None], source[None, 1:])
    vertical = shared.clip(min=0) / (target[:-1] - target[1:])[:, None]
    horizontal = _column_weights(width, cols, rotation)
    out: Doubles = np.einsum("ih,hwc->iwc", vertical, radiance.astype(np.float64), optimize=True)
    out = np.einsum("jw,iwc->ijc", horizontal, out, optimize=True)
    return out.astype(np.float32)


def _column_weights(width: int, cols: int, rotation: float) -> Doubles:
    """Returns the weight of each source column in each target column, [cols, width]; rows sum to 1."""
    # In units of source columns: target column j covers [low, low + span) of the unturned map, modulo the width.
    span = width / cols
    low = np.arange(cols) * span - rotation / (2 * pi) * width
    left = np.arange(width)
    weights = np.zeros((cols, width))
    # Shifts by whole turns, enough for low in any position and a span of up to a full turn.
    start = np.mod(low, width)[:, None]
    for turn in (0, width):
        overlap = np.minimum(start + span, left + 1 + turn) - np.maximum(start, left + turn)
        weights += overlap.clip(min=0)
    return weights / span


LIGHTS = "lights"
LIGHTS_ROWS = 128
"""Rows of the map; it has twice as many columns."""
SPOT_WIDTH = 0.15
"""Standard deviation of a light's spot, radians (8.6°)."""
LIGHTS_VERSION = "lights 1"
"""Changes when the same lights give another map: it stands for the map in a scene's digest."""


def lights_map(lights: Lights) -> EnvironmentMap:
    """Returns the map of `lights`, [LIGHTS_ROWS, 2 LIGHTS_ROWS, 3], white.

    A light at the origin itself, and a spot light whose cone misses it, are left out.
    """
    polar = (np.arange(LIGHTS_ROWS) + 0.5) * (pi / LIGHTS_ROWS)
    azimuth = (np.arange(2 * LIGHTS_ROWS) + 0.5) * (pi / LIGHTS_ROWS)
    theta, phi = np.meshgrid(polar, azimuth, indexing="ij")
    directions = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=-1)
    radiance = lights.ambient * (1 + directions[..., 1] / 2)
    for towards, irradiance in _seen_from_the_origin(lights):
        radiance += irradiance * _spot(directions @ towards)
    values = np.repeat(radiance[..., None], 3, axis=-1).astype(np.float32)
    return EnvironmentMap(LIGHTS, values, hashlib.sha256(LIGHTS_VERSION.encode()).hexdigest(), credit=None)


def _seen_from_the_origin(lights: Lights) -> list[tuple[Doubles, float]]:
    """Returns each light's direction, a unit vector, and its irradiance on a surface that faces it."""
    sources = []
    for point in lights.points:
        sources.append((np.array(point.position, float), point.energy))
    for spot in lights.spots:
        place, axis = np.array(spot.position, float), np.array(spot.direction, float)
        distance = np.linalg.norm(place)
        if distance > 0:
            cosine = float(-(place @ axis) / (distance * np.linalg.norm(axis)))
            inner, outer = cos(spot.inner_angle), cos(spot.outer_angle)
            share = min(1.0, max(0.0, (cosine - outer) / max(inner - outer, 1e-9)))
            sources.append((place, spot.energy * share**2))
    near = [(place / np.linalg.norm(place), energy / float(place @ place)) for place, energy in sources if place.any()]
    far = [(-np.array(light.direction, float), light.energy) for light in lights.directional]
    return near + [(towards / np.linalg.norm(towards), energy) for towards, energy in far]


def _spot(cosine: Doubles) -> Doubles:
    """Returns the density of the spot at cosines of the angle to its middle; its integral over the sphere is 1."""
    kappa = 1 / SPOT_WIDTH**2
    density: Doubles = kappa / (2 * pi * (1 - exp(-2 * kappa))) * np.exp(kappa * (cosine - 1))
    return density
