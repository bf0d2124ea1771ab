"""Light that a room could have, in seven numbers: the environment map is turned, dimmed, made warmer or cooler, and one
soft lamp is added to it. They stand for the free texels of `illumination`, which no room has.

Each number is a share of its natural range, 0 at the start and at most 1 either way (the lamp's power: 0 to 1), so that
one step and one limit suit all of them. The ranges, and what a room has:

- turn about +y, ±30°: the sun's hour angle changes by 15° an hour (Duffie & Beckman 2013, section 1.6), so this is two
  hours either way;
- brightness, ±1 stop: EN 12464-1 asks for 300 lx to file, 500 lx to write and 750 lx to draw;
- colour temperature, 2,700 to 6,500 K: the white lamps of ANSI C78.377-2008, from the warmest to daylight. The scene's
  own map counts as the middle of the range in mireds, 3,815 K; equal steps in mireds look about equally large;
- the lamp's power, up to that of the map: a surface that faces the lamp then gets up to 4 times the light that an even
  map of this power gives it, a lighting ratio of 5 : 1; portraits have 2 : 1 to 8 : 1;
- its elevation, 0 to 90°, and its azimuth, all around: 45° at the start, the place of a key light;
- its radius, 10 to 40°, 20° at the start: a shade of 0.5 m at 1.4 m, to a window of 1.7 m at 1 m. Smaller ones would
  fall between the texels of the default map, which are 11° wide.

While the lamp has no power, its place and size have no effect and no gradient: they begin to move after the power does.
"""

from dataclasses import dataclass
from math import log, pi
from typing import NamedTuple

import torch
from torch import Tensor

from scene_attack.rendering.torch.light import LUMINANCE, Illumination, directions, solid_angles
from scene_attack.scenes.environment import average
from scene_attack.scenes.resolve import ResolvedScene

LOWEST = (-1.0, -1.0, -1.0, 0.0, -1.0, -1.0, -1.0)
"""Least values of the group: a lamp has no power below 0."""
LARGEST_TURN = 30.0
"""Largest turn of the map, degrees."""
WARMEST, COOLEST = 2700.0, 6500.0
"""Range of the colour temperature, kelvin."""
PLACE, REACH = 45.0, (180.0, 45.0)
"""Azimuth and elevation of the lamp at the start, and by how much they change at most, degrees."""
RADIUS, LARGEST_RATIO = 20.0, 2.0
"""Radius of the lamp at the start, degrees, and the largest ratio of another to it."""
LEAST_CHROMA = 0.01
"""A texel whose own light has less of a channel than this, beside a luminance of 1, takes no more of it: its intensity
is in units of its colour."""
TO_SRGB = ((3.2406, -1.5372, -0.4986), (-0.9689, 1.8758, 0.0415), (0.0557, -0.2040, 1.0570))
"""From CIE XYZ to linear RGB (IEC 61966-2-1)."""


class Light(NamedTuple):
    """Values of the group in physical units, tensors of any shape."""

    turn: Tensor
    """Turn of the map about +y, degrees; positive from +z towards +x."""
    brightness: Tensor
    """Factor on the map's radiance."""
    temperature: Tensor
    """Colour temperature of the map, kelvin."""
    power: Tensor
    """Power of the lamp, in that of the map before it was dimmed."""
    azimuth: Tensor
    """Azimuth of the lamp, degrees, as the camera's: about +y, from +z towards +x."""
    elevation: Tensor
    """Its elevation above the horizon, degrees."""
    radius: Tensor
    """Angle from its middle at which its radiance is half of that there, degrees."""


def physical(values: Tensor) -> Light:
    """Returns values [..., 7] of the group in physical units."""
    turn, exposure, temperature, power, azimuth, elevation, size = values.unbind(-1)
    middle, half = (1 / WARMEST + 1 / COOLEST) / 2, (1 / WARMEST - 1 / COOLEST) / 2
    return Light(
        turn=LARGEST_TURN * turn,
        brightness=exposure.exp2(),
        temperature=1 / (middle - half * temperature),
        power=power,
        azimuth=PLACE + REACH[0] * azimuth,
        elevation=PLACE + REACH[1] * elevation,
        radius=RADIUS * LARGEST_RATIO**size,
    )


@dataclass(frozen=True)
class Lamp:
    """The map that is turned and dimmed, and the texels that take the lamp's light.

    chroma float64 [rows, cols, 3], the colours of the texels; angles [rows, cols], their solid angles; power, the
    integral of the map's own intensity over the sphere. columns float64 [rows, width, 3], the radiance of the source
    map's columns, averaged to the texels' rows, in the unit of intensities; sums [rows, width + 1, 3] of the columns
    before each; rotation, the map's own turn, radians.
    """

    chroma: Tensor
    angles: Tensor
    power: float
    columns: Tensor
    sums: Tensor
    rotation: float

    @classmethod
    def of(cls, scene: ResolvedScene, light: Illumination) -> "Lamp":
        """Takes the map of a scene, whose factors are `light`. Without a source map its texels are taken to be even."""
        rows, cols = light.intensity.shape
        source, rotation = scene.source_map, scene.description.lights.environment.rotation
        if source is None:  # the texels are turned already
            source, rotation = scene.environment, 0.0
        unit = float((light.chroma * light.intensity[..., None]).sum()) / (
            float(scene.environment.sum(dtype=float)) or 1
        )
        columns = torch.as_tensor(average(source, rows, source.shape[1])).to(light.chroma) * unit
        sums = torch.nn.functional.pad(columns.cumsum(1), (0, 0, 1, 0))
        angles = solid_angles(rows, cols).view(rows, cols).to(light.chroma)
        return cls(light.chroma, angles, float((light.intensity * angles).sum()), columns, sums, rotation)

    def added(self, values: Tensor, intensity: Tensor) -> Tensor:
        """Returns what the values [7] of the group add to each texel and channel: a value [rows, cols, 3] of
        `illumination_rgb`, of the values' dtype and device. Zeros add exactly 0. It is differentiable by both.

        `intensity` [rows, cols] is the map's as it is now: the whole of it is dimmed, and the lamp is a share of it.
        """
        light, now = physical(values.to(self.chroma)), intensity.to(self.chroma)
        power = (now * self.angles).sum()
        turned = self.turned(light.turn) - self.turned(torch.zeros_like(light.turn))
        factor = light.brightness * tint(light.temperature)
        lamp = light.power * power * self.lobe(light)
        takes = self.chroma > LEAST_CHROMA
        other = factor * turned * (power / (self.power or 1.0)) + lamp[..., None]
        other = torch.where(takes, other / torch.where(takes, self.chroma, 1.0), 0.0)
        return (now[..., None] * (factor - 1) + other).to(values)

    def turned(self, turn: Tensor) -> Tensor:
        """Returns the map's radiance [rows, cols, 3] in the unit of intensities, turned by further degrees.

        Each texel is the mean of the columns of the source map that it covers, in part at its edges, as
        `environment.average` has it: so the texels of a row always add up to the same. The derivative by the turn is
        the difference of the columns at a texel's edges.
        """
        cols, width = self.chroma.shape[1], self.columns.shape[1]
        texel = width / cols
        edges = texel * torch.arange(cols + 1).to(self.angles)
        edges = edges - (self.rotation + turn.deg2rad()) * (width / (2 * pi))
        whole = (edges / width).floor().detach()
        within = edges - whole * width
        column = within.detach().long().clamp(0, width - 1)
        part = (within - column)[:, None] * self.columns[:, column]
        integral = whole[:, None] * self.sums[:, -1:] + self.sums[:, column] + part
        return integral.diff(dim=1) / texel

    def lobe(self, light: Light) -> Tensor:
        """Returns the density [rows, cols] of the lamp's light, 1/steradian: a von Mises-Fisher lobe, of which the
        texels have 1 in all."""
        rows, cols = self.angles.shape
        azimuth, elevation = light.azimuth.deg2rad(), light.elevation.deg2rad()
        flat = elevation.cos()
        middle = torch.stack((flat * azimuth.sin(), elevation.sin(), flat * azimuth.cos()))
        cosines = (directions(rows, cols).to(self.angles) @ middle).view(rows, cols)
        density = (log(2) * (cosines - 1) / (1 - light.radius.deg2rad().cos())).exp()
        return density / (density * self.angles).sum()


def tint(temperature: Tensor) -> Tensor:
    """Returns the factors [3] on linear RGB that bring the map's neutral temperature to another, kelvin: the ratio of
    the white points. The luminance of a white map is kept; for the neutral temperature the factors are exactly 1."""
    ratio = white_point(temperature) / white_point(physical(torch.zeros(7).to(temperature)).temperature)
    weights = torch.tensor(LUMINANCE, dtype=ratio.dtype, device=ratio.device)
    return ratio * (weights.sum() / (weights * ratio).sum())


def white_point(temperature: Tensor) -> Tensor:
    """Returns the linear RGB [3], of luminance 1, of a black body at a temperature from 1,000 to 15,000 K.

    Its chromaticity (CIE 1960) is Krystek's approximation (Color Research & Application 10(1), 1985, p. 38), which is
    off by less than 1e-4.
    """
    t = temperature
    u = (0.860117757 + 1.54118254e-4 * t + 1.28641212e-7 * t**2) / (1 + 8.42420235e-4 * t + 7.08145163e-7 * t**2)
    v = (0.317398726 + 4.22806245e-5 * t + 4.20481691e-8 * t**2) / (1 - 2.89741816e-5 * t + 1.61456053e-7 * t**2)
    xyz = torch.stack((1.5 * u / v, torch.ones_like(u), (2 - 0.5 * u) / v - 5))
    return torch.tensor(TO_SRGB, dtype=xyz.dtype, device=xyz.device) @ xyz
