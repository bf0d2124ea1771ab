"""The curves of the study: successes against work over all cases, and the paper's mean curves, as SVG.

A figure has panels side by side under one legend. The same data give the same text. It stands on a white card of its
own, so that it can be read on pages with a dark background too.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10

from benchmarks.study.record import Record
from benchmarks.study.tables import attacks, title
from services.analysis.campaign_table import Cell, Corners, MeanCurves, corners

COLOURS = ("#4a2fd6", "#c2410c", "#0b6b3a", "#b0206a", "#0a5a94", "#7a5c00")
"""Colours of the series, in order; on white each has a contrast of at least 4.5."""
INK, SOFT, LINE, CARD = "#1c1930", "#5d5875", "#e2deef", "#ffffff"
WIDTH, HEIGHT = 300, 190
"""Size of a panel's plotting area, in SVG units."""
LEFT, RIGHT, TOP, BOTTOM, LEGEND = 52, 18, 34, 46, 34
"""Margins of a panel, and the height of the legend."""
FONT = "font-family:system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif"
CHARACTER = 6.6
"""Mean width of a character of the legend."""


@dataclass(frozen=True)
class Series:
    """A line through points (x, y); as steps if `steps`: y holds from its x to the next."""

    name: str
    points: Sequence[tuple[float, float]]
    steps: bool = False


@dataclass(frozen=True)
class Panel:
    """A chart of several series; the axes have the given ends. A logarithmic x axis starts above 0."""

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    x: tuple[float, float]
    y: tuple[float, float]
    logarithmic: bool = False
    lines: Sequence[float] = ()
    """Values of x that are marked by a vertical line."""


def figure(panels: Sequence[Panel], names: Sequence[str]) -> str:
    """The panels side by side as an SVG. `names` are those of the series in the order of the legend and colours."""
    colour = dict(zip(names, COLOURS, strict=False))
    wide, high = len(panels) * (LEFT + WIDTH + RIGHT), TOP + HEIGHT + BOTTOM + LEGEND
    about = "; ".join(panel.title for panel in panels)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" width="{wide}" role="img" '
        f'aria-label="{escape(about)}" style="{FONT};font-size:11px">',
        f'<rect width="{wide}" height="{high}" rx="10" fill="{CARD}"/>',
        *_legend(names, colour),
    ]
    for index, panel in enumerate(panels):
        left = index * (LEFT + WIDTH + RIGHT) + LEFT
        parts.append(f'<g transform="translate({left} {LEGEND + TOP})">')
        parts += _panel(panel, colour)
        parts.append("</g>")
    return "\n".join([*parts, "</svg>"]) + "\n"


def _legend(names: Sequence[str], colour: dict[str, str]) -> Iterable[str]:
    x = float(LEFT)
    for name in names:
        yield f'<line x1="{x:.1f}" x2="{x + 18:.1f}" y1="20" y2="20" stroke="{colour[name]}" stroke-width="3"/>'
        yield f'<text x="{x + 24:.1f}" y="24" fill="{INK}" font-size="12">{escape(name)}</text>'
        x += 24 + CHARACTER * len(name) + 22


def _panel(panel: Panel, colour: dict[str, str]) -> Iterable[str]:
    def at(x: float, y: float) -> tuple[float, float]:
        return _place(x, panel.x, panel.logarithmic) * WIDTH, HEIGHT - _place(y, panel.y, False) * HEIGHT

    yield f'<text x="0" y="-14" fill="{INK}" font-size="13" font-weight="600">{escape(panel.title)}</text>'
    for value in _ticks(panel.y):
        y = at(panel.x[0], value)[1]
        yield f'<line x1="0" x2="{WIDTH}" y1="{y:.1f}" y2="{y:.1f}" stroke="{LINE}"/>'
        yield f'<text x="-7" y="{y + 4:.1f}" fill="{SOFT}" text-anchor="end">{value:g}</text>'
    for value in _powers(panel.x) if panel.logarithmic else _ticks(panel.x):
        x = at(value, panel.y[0])[0]
        yield f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{HEIGHT}" y2="{HEIGHT + 4}" stroke="{SOFT}"/>'
        yield f'<text x="{x:.1f}" y="{HEIGHT + 17}" fill="{SOFT}" text-anchor="middle">{value:,g}</text>'
    for value in panel.lines:
        x = at(value, panel.y[0])[0]
        yield f'<line x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{HEIGHT}" stroke="{SOFT}" stroke-dasharray="3 3"/>'
    yield f'<text x="{WIDTH / 2}" y="{HEIGHT + 36}" fill="{SOFT}" text-anchor="middle">{escape(panel.x_label)}</text>'
    yield (
        f'<text transform="translate(-38 {HEIGHT / 2}) rotate(-90)" fill="{SOFT}" text-anchor="middle">'
        f"{escape(panel.y_label)}</text>"
    )
    for series in panel.series:
        places = [at(*point) for point in _within(series, panel)]
        path = " ".join(f"{'M' if not i else 'L'}{x:.1f} {y:.1f}" for i, (x, y) in enumerate(places))
        yield (
            f'<path d="{path}" fill="none" stroke="{colour[series.name]}" stroke-width="2.2" stroke-linejoin="round" '
            f'stroke-linecap="round"><title>{escape(series.name)}</title></path>'
        )


def _within(series: Series, panel: Panel) -> list[tuple[float, float]]:
    """The points between the ends of the x axis, with the corners of steps; the last value holds to the end."""
    inside = [(max(x, panel.x[0]), y) for x, y in series.points if x <= panel.x[1]]
    if not series.steps:
        return inside
    corners: list[tuple[float, float]] = []
    for x, y in inside:
        corners += [(x, corners[-1][1]), (x, y)] if corners else [(x, y)]
    return [*corners, (panel.x[1], corners[-1][1])] if corners else []


def _place(value: float, ends: tuple[float, float], logarithmic: bool) -> float:
    """Position of a value between the ends of an axis, in [0,1]."""
    low, high, value = (log10(v) if logarithmic else v for v in (*ends, value))
    return min(1.0, max(0.0, (value - low) / (high - low)))


def _ticks(ends: tuple[float, float], most: int = 5) -> list[float]:
    """At most `most` + 1 round values between the ends."""
    low, high = ends
    least = (high - low) / most
    power = 10.0 ** floor(log10(least))
    step = next(factor * power for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * power >= least * (1 - 1e-9))
    first, last = ceil(low / step - 1e-9), floor(high / step + 1e-9)
    return [round(number * step, 10) for number in range(first, last + 1)]


def _powers(ends: tuple[float, float]) -> list[float]:
    """The powers of ten between the ends, with 2 and 5 times them if there are few."""
    low, high = ends
    decades = range(floor(log10(low)), ceil(log10(high)) + 1)
    factors = (1.0,) if len(decades) > 4 else (1.0, 3.0) if len(decades) > 3 else (1.0, 2.0, 5.0)
    return [f * 10.0**d for d in decades for f in factors if low * (1 - 1e-9) <= f * 10.0**d <= high * (1 + 1e-9)]


def differentiable(record: Record, target: str) -> str:
    """Panels of one network: successes against queries, and the mean probability of the truth."""
    cells, curves = _own(record, target)
    panels = (
        _success(cells, f"{title(target)}: success against queries", "queries", _by_queries(cells), 1.0),
        _mean(curves, "Mean probability of the right answer", "over all cases", "loss", (0, 1)),
    )
    return figure(panels, [cell.attack for cell in cells])


def questions(record: Record, target: str) -> str:
    """Panels of one network that answers questions, each attacked by itself: successes against steps, queries and p."""
    cells = [cell for cell in _own(record, target)[0] if cell.attack in attacks(record)]
    jobs = [job for job in record.jobs if job.target == target and job.success]
    own = {cell.attack: [job for job in jobs if job.attack == cell.attack] for cell in cells}
    by_step = {attack: corners([job.step or 0.0 for job in of]) for attack, of in own.items()}
    by_p = {attack: corners([1000 * (job.p or 0.0) for job in of]) for attack, of in own.items()}
    panels = (
        _success(cells, f"{title(target)}: success against steps", "step", by_step),
        _success(cells, f"{title(target)}: success against queries", "queries", _by_queries(cells), 1.0),
        _success(cells, "Success against p", "p ×10⁻³", by_p),
    )
    return figure(panels, [cell.attack for cell in cells])


def nondifferentiable(record: Record, target: str) -> str:
    """Panels of one network, as in the paper: successes against queries, the mean advantage, and the mean distance."""
    cells, curves = _own(record, target)
    top = max((max(curve.advantage) for curve in curves), default=1.0)
    bottom = min(0.0, min((min(curve.advantage) for curve in curves), default=0.0))
    far = max((max(curve.distance) for curve in curves), default=1.0)
    sides = (bottom * 1.05, top * 1.05)
    panels = (
        _success(cells, f"{title(target)}: success against queries", "queries", _by_queries(cells), 1.0),
        _mean(curves, "Mean log-probability advantage", "below 0: fooled", "advantage", sides),
        _mean(curves, "Mean distance of the image", "‖ΔY‖₂", "distance", (0, far * 1.05)),
    )
    return figure(panels, [cell.attack for cell in cells])


def _own(record: Record, target: str) -> tuple[list[Cell], list[MeanCurves]]:
    cells = [cell for cell in record.table().cells if cell.target == target and cell.success.of]
    return cells, [curve for curve in record.curves if curve.target == target]


def _by_queries(cells: Sequence[Cell]) -> dict[str, Corners]:
    """The corners of each attack's number of successes against queries."""
    return {cell.attack: cell.by_queries for cell in cells}


def _success(cells: Sequence[Cell], name: str, unit: str, reached: Mapping[str, Corners], start: float = 0.0) -> Panel:
    """Successes against their cost. `start`: lower end of a logarithmic axis; 0 for a linear one."""
    largest = max((at for own in reached.values() for at, _ in own), default=10.0 * start) or 1.0
    lines = []
    for cell in cells:
        points = [(at, 100 * count / cell.success.of) for at, count in reached[cell.attack]]
        lines.append(Series(cell.attack, [(start, 0.0), *points], steps=True))
    ends, label = (0.0, 1.05 * largest), unit
    if start:
        ends, label = (start, max(largest * 1.1, 10 * start)), f"{unit} (logarithmic)"
    return Panel(name, label, "verified, % of all cases", lines, ends, (0, 100), logarithmic=start > 0)


def _mean(curves: Sequence[MeanCurves], name: str, unit: str, of: str, ends: tuple[float, float]) -> Panel:
    """Mean curves up to the last step of all: cases that have ended keep their last value."""
    steps = max((len(curve.loss) for curve in curves), default=2) - 1
    lines = [
        Series(curve.attack, [*enumerate(getattr(curve, of)), (steps, getattr(curve, of)[-1])]) for curve in curves
    ]
    return Panel(name, "step", unit, lines, (0, steps), ends)
