"""Lays out a polar plot of a quantity before and after, over angles from −90° (left) to 90° (right)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

RADIUS = 90.0
"""Radius of the largest value, in SVG units; the pole is at (0, 0)."""


@dataclass(frozen=True)
class Polar:
    """A plot: paths of the curves in SVG units."""

    name: str
    before: str
    after: str
    largest: float
    rows: list[tuple[float, float, float]]
    """Angle in degrees, value before, value after."""


def polar(curve: Mapping[str, Any]) -> Polar:
    """The plot of a curve (services.rendering.physical_change.Curve), whose larger maximum has the largest radius."""
    angles, before, after = curve["angles"], curve["before"], curve["after"]
    largest = max(*before, *after)
    scale = RADIUS / largest if largest > 0 else 0.0
    rows = list(zip(angles, before, after, strict=True))
    return Polar(curve["name"], _path(angles, before, scale), _path(angles, after, scale), largest, rows)


def _path(angles: Sequence[float], values: Sequence[float], scale: float) -> str:
    points = [(scale * v * sin(radians(a)), -scale * v * cos(radians(a))) for a, v in zip(angles, values, strict=True)]
    # adding 0 turns −0 into 0
    return "M0 0 L" + " L".join(f"{round(x, 1) + 0:g} {round(y, 1) + 0:g}" for x, y in points) + " Z"
