"""Lays out charts in SVG units, which the templates then write: curves, UpSet plots and polar plots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, floor, isfinite, log10, radians, sin
from typing import Any

from scene_attack.runs.result import subset_image

WIDTH, HEIGHT = 420, 210
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 12, 28
"""Margins in SVG units."""
BUCKETS = 200
"""A long curve is divided into this number of buckets, and drawn through the lowest and highest point of each."""


@dataclass(frozen=True)
class Tick:
    """A tick of an axis: its position in SVG units, and its text."""

    at: float
    text: str


@dataclass(frozen=True)
class Chart:
    """A chart with one or several curves over common axes; positions are in SVG units."""

    title: str
    x_label: str
    summary: str
    paths: list[str | None]
    """The curves, in their order; None for one without finite points."""
    last: tuple[float, float] | None
    """The end of the curve, where there is only one."""
    x_ticks: list[Tick]
    y_ticks: list[Tick]
    threshold: float | None
    note: str


def chart(
    title: str,
    x_label: str,
    points: Sequence[tuple[float, float]],
    *,
    include: Sequence[float] = (),
    threshold: float | None = None,
    note: str = "",
    whole: bool = False,
) -> Chart:
    """Lays out a curve through `points` (x, y), of which at least one must be finite.

    The y axis has the values `include` and `threshold`; a line is drawn at `threshold`. The ticks of the x axis are
    whole numbers if `whole` is true.
    """
    points = _finite(points)
    drawn = [*include] if threshold is None else [*include, threshold]
    x_axis, y_axis = _axes(points, drawn)
    (first_x, first), (last_x, last) = points[0], points[-1]
    return Chart(
        title=title,
        x_label=x_label,
        summary=f"{title}: {first:.3g} at {first_x:.3g}, {last:.3g} at {last_x:.3g} ({x_label})",
        paths=[_path(points, x_axis, y_axis)],
        last=(x_axis.at(last_x), y_axis.at(last)),
        x_ticks=x_axis.ticks(6, least=1.0 if whole else 0.0),
        y_ticks=y_axis.ticks(5),
        threshold=None if threshold is None else y_axis.at(threshold),
        note=note,
    )


def overlay(
    title: str,
    x_label: str,
    curves: Sequence[tuple[str, Sequence[tuple[float, float]]]],
    include: Sequence[float] = (),
) -> Chart | None:
    """Lays out curves, each a name and points (x, y), over common axes; None if no point is finite.

    The y axis has the values `include`.
    """
    finite = [_finite(points) for _, points in curves]
    if not any(finite):
        return None
    x_axis, y_axis = _axes([point for points in finite for point in points], include)
    ends = [f"{name} {points[-1][1]:.3g}" for (name, _), points in zip(curves, finite, strict=True) if points]
    return Chart(
        title=title,
        x_label=x_label,
        summary=f"{title} against {x_label}; at the end: {', '.join(ends)}",
        paths=[_path(points, x_axis, y_axis) if points else None for points in finite],
        last=None,
        x_ticks=x_axis.ticks(6),
        y_ticks=y_axis.ticks(5),
        threshold=None,
        note="",
    )


def _finite(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    return [point for point in points if isfinite(point[0]) and isfinite(point[1])]


def _axes(points: Sequence[tuple[float, float]], include: Sequence[float]) -> "tuple[_Axis, _Axis]":
    x_axis = _Axis([x for x, _ in points], LEFT, WIDTH - RIGHT)
    return x_axis, _Axis([*(y for _, y in points), *include], HEIGHT - BOTTOM, TOP)


def _path(points: Sequence[tuple[float, float]], x_axis: "_Axis", y_axis: "_Axis") -> str:
    return "M" + " L".join(f"{x_axis.at(x):.1f} {y_axis.at(y):.1f}" for x, y in _thinned(points))


class _Axis:
    """A linear map from values to positions between `start` and `end`, in SVG units."""

    def __init__(self, values: Sequence[float], start: float, end: float) -> None:
        self._low, self._high = min(values), max(values)
        if self._high - self._low < 1e-12 * max(1.0, abs(self._low)):
            self._high = self._low + max(1.0, abs(self._low))
        self._start, self._end = start, end

    def at(self, value: float) -> float:
        part = (value - self._low) / (self._high - self._low)
        return self._start + part * (self._end - self._start)

    def ticks(self, most: int, least: float = 0.0) -> list[Tick]:
        """At most `most` ticks, at multiples of 1, 2 or 5 times a power of ten of at least `least`."""
        step = _nice(max(least, (self._high - self._low) / (most - 1)))
        first = -floor(-self._low / step + 1e-9)
        values = [(first + i) * step for i in range(most + 1) if (first + i) * step <= self._high + step * 1e-9]
        return [Tick(round(self.at(value), 1), f"{value:.6g}") for value in values]


def _nice(least: float) -> float:
    """The smallest of 1, 2, 5, 10, … times a power of ten that is not below `least`."""
    power = 10.0 ** floor(log10(least))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1 - 1e-9))


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    if len(points) <= 2 * BUCKETS:
        return list(points)
    kept = {0, len(points) - 1}
    for bucket in range(BUCKETS):
        span = range(bucket * len(points) // BUCKETS, (bucket + 1) * len(points) // BUCKETS)
        kept |= {min(span, key=lambda i: points[i][1]), max(span, key=lambda i: points[i][1])}
    return [points[i] for i in sorted(kept)]


GROUPS_WIDTH, COLUMN, ROW = 230, 60, 30
"""Widths of the part with the groups and of a column, and height of a row, in SVG units."""
IMAGE, BAR, GAP = 54, 90, 12
"""Heights of the images and of the highest bar, and what is between the parts."""
SHAPLEY, ZERO = 40, 182
"""Width of the longest bar of a Shapley value on either side of zero, and the place of zero."""


@dataclass(frozen=True)
class Column:
    """A subset; positions are in SVG units."""

    x: float
    image: str
    """Name of its image among the job's files; empty if it was not kept."""
    words: str
    outcome: str
    met: bool
    """Whether the goal is met."""
    probability: float
    top: float
    dots: list[tuple[float, bool]]
    """Height of each group's dot, and whether the subset has the group."""
    line: tuple[float, float] | None
    """Heights of the first and last dot, if it has several groups."""


@dataclass(frozen=True)
class Group:
    """A group's row."""

    y: float
    words: str
    shapley: float
    start: float
    width: float


@dataclass(frozen=True)
class Upset:
    """An UpSet plot (Lex et al. 2014) of the subsets of an attack's groups.

    A column is a subset: its image, a bar of the probability of the goal's label, and a dot for each group that it has.
    A row is a group: its name, and a bar of its Shapley value.
    """

    width: float
    height: float
    bars: float
    """Height of the line on which the bars stand."""
    columns: list[Column]
    groups: list[Group]


def upset(
    subsets: Sequence[Mapping[str, Any]],
    attribution: Mapping[str, Any],
    words: Mapping[str, str],
    files: Sequence[str],
) -> Upset | None:
    """The plot of the rows of a table of subsets; None for fewer than two groups, of which there is nothing to tell.

    `words` has the name of each group on pages, in the order of the rows. `files` are the names of the job's files.
    """
    if len(words) < 2 or len(subsets) < 4:
        return None
    bars = GAP + IMAGE + GAP + BAR
    rows = {group: bars + GAP + ROW * (k + 0.5) for k, group in enumerate(words)}
    shapley = dict(zip(attribution["parts"], attribution["log_odds"]["shapley"], strict=True))
    largest = max(abs(value) for value in shapley.values()) or 1.0
    groups = []
    for group, name in words.items():
        value = shapley[group]
        length = SHAPLEY * value / largest
        groups.append(Group(rows[group], name, value, ZERO + min(0.0, length), abs(length)))
    columns = [
        _column(k, subset, len(subsets), rows, words, set(files), GROUPS_WIDTH + COLUMN * (k + 0.5), bars)
        for k, subset in enumerate(subsets)
    ]
    return Upset(GROUPS_WIDTH + COLUMN * len(columns), bars + GAP + ROW * len(rows) + GAP, bars, columns, groups)


def _column(
    number: int,
    subset: Mapping[str, Any],
    of: int,
    rows: Mapping[str, float],
    words: Mapping[str, str],
    files: set[str],
    x: float,
    bars: float,
) -> Column:
    image = {0: "original.png", of - 1: "attacked.png"}.get(number, subset_image(number))
    has = [rows[group] for group in subset["groups"]]
    return Column(
        x=x,
        image=image if image in files else "",
        words=" + ".join(words[group] for group in subset["groups"]) or "none",
        outcome=subset["outcome"],
        met=subset["fooled"],
        probability=subset["goal_probability"],
        top=bars - BAR * subset["goal_probability"],
        dots=[(y, group in subset["groups"]) for group, y in rows.items()],
        line=(min(has), max(has)) if len(has) > 1 else None,
    )


RADIUS = 90.0
"""Radius of the largest value, in SVG units; the pole is at (0, 0)."""


@dataclass(frozen=True)
class Polar:
    """A quantity before and after, over angles from −90° (left) to 90° (right): paths of the curves in SVG units."""

    name: str
    before: str
    after: str
    largest: float
    rows: list[tuple[float, float, float]]
    """Angle in degrees, value before, value after."""


def polar(curve: Mapping[str, Any]) -> Polar:
    """The plot of a `scene_attack.rendering.physical_change.Curve`, whose larger maximum has the largest radius."""
    angles, before, after = curve["angles"], curve["before"], curve["after"]
    largest = max(*before, *after)
    scale = RADIUS / largest if largest > 0 else 0.0
    rows = list(zip(angles, before, after, strict=True))
    return Polar(curve["name"], _polar_path(angles, before, scale), _polar_path(angles, after, scale), largest, rows)


def _polar_path(angles: Sequence[float], values: Sequence[float], scale: float) -> str:
    points = [(scale * v * sin(radians(a)), -scale * v * cos(radians(a))) for a, v in zip(angles, values, strict=True)]
    # adding 0 turns −0 into 0
    return "M0 0 L" + " L".join(f"{round(x, 1) + 0:g} {round(y, 1) + 0:g}" for x, y in points) + " Z"


def around(views: Sequence[Mapping[str, Any]]) -> list[tuple[str, float, float]]:
    """Where the views of a range (`scene_attack.analysis.records.SeenFrom`) are on a circle seen from above: the answer
    there, and the place. The scene's own view is below, and the camera goes to the right of the image from there.
    """
    angles = [(view["answer"], radians(view["azimuth"])) for view in views]
    return [(answer, round(RADIUS * sin(a), 1), round(RADIUS * cos(a), 1)) for answer, a in angles]
