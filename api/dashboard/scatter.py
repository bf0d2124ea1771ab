"""Computes the layout of a plot of points on two logarithmic axes in an SVG of fixed size."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10

from api.dashboard.charts import Tick

WIDTH, HEIGHT = 640, 400
LEFT, RIGHT, TOP, BOTTOM = 62, 16, 14, 46
"""Margins in SVG units."""
MOST_TICKS = 9


@dataclass(frozen=True)
class Point:
    """A measurement: two positive values, and what it is of."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Mark:
    """A point in SVG units, and its text."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Series:
    """Points of one kind; `number` chooses their colour and shape."""

    name: str
    number: int
    marks: list[Mark]


@dataclass(frozen=True)
class Scatter:
    """A plot on logarithmic axes. `left_out` is the number of points that are zero and have no place on them."""

    title: str
    x_label: str
    y_label: str
    summary: str
    series: list[Series]
    x_ticks: list[Tick]
    y_ticks: list[Tick]
    left_out: int


def scatter(title: str, x_label: str, y_label: str, points: Mapping[str, Sequence[Point]]) -> Scatter | None:
    """Lays out the points of each series by name; None if none of them has a place."""
    placed = {name: [one for one in own if _has_place(one)] for name, own in points.items()}
    shown = [one for own in placed.values() for one in own]
    if not shown:
        return None
    x_axis = _LogAxis([one.x for one in shown], LEFT, WIDTH - RIGHT)
    y_axis = _LogAxis([one.y for one in shown], HEIGHT - BOTTOM, TOP)
    series = [
        Series(name, number, [Mark(round(x_axis.at(p.x), 1), round(y_axis.at(p.y), 1), p.text) for p in own])
        for number, (name, own) in enumerate(placed.items())
    ]
    return Scatter(
        title=title,
        x_label=x_label,
        y_label=y_label,
        summary=f"{title}: {len(shown)} points, {y_label} from {min(one.y for one in shown):.1e} to "
        f"{max(one.y for one in shown):.1e} against {x_label}; the table below has all of them",
        series=[one for one in series if one.marks],
        x_ticks=x_axis.ticks(),
        y_ticks=y_axis.ticks(),
        left_out=sum(map(len, points.values())) - len(shown),
    )


def _has_place(point: Point) -> bool:
    return all(isfinite(value) and value > 0 for value in (point.x, point.y))


class _LogAxis:
    """A map from positive values to positions between `start` and `end`, by their logarithm, over whole decades."""

    def __init__(self, values: Sequence[float], start: float, end: float) -> None:
        self._low, self._high = floor(log10(min(values))), ceil(log10(max(values)))
        self._high = max(self._high, self._low + 1)
        self._start, self._end = start, end

    def at(self, value: float) -> float:
        return self._start + (log10(value) - self._low) / (self._high - self._low) * (self._end - self._start)

    def ticks(self) -> list[Tick]:
        """Powers of ten, every one or, of many decades, every second or third and so on."""
        stride = -(-(self._high - self._low) // MOST_TICKS)
        return [
            Tick(round(self.at(10.0**k), 1), f"1e{k}" if k else "1") for k in range(self._low, self._high + 1, stride)
        ]
