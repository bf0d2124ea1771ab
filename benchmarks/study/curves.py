"""The curves of the study: successes against work over all cases, and the paper's mean curves, as SVG.

A figure has panels side by side under one legend. The same data give the same text.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.study.record import Record
from benchmarks.study.tables import SETTING, attacks, title
from scene_attack.analysis.campaign_figure import COLOURS, PANEL, STYLE
from scene_attack.analysis.campaign_table import Cell, Corners, MeanCurves, corners

AS_TEXT = {"svg.fonttype": "none", "svg.hashsalt": "study"}
"""Settings of an SVG: words as text, and names of its parts that are the same every time."""


@dataclass(frozen=True)
class Series:
    """A line through points (x, y); as steps if `steps`: y holds from its x to the next, the last one to the end."""

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
    text = StringIO()
    with mpl.rc_context(STYLE | AS_TEXT):
        drawn = Figure(figsize=(PANEL[0] * len(panels), PANEL[1]), layout="constrained")
        for axes, panel in zip(drawn.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            _draw(axes, panel, colour)
        handles = [Line2D([], [], color=colour[name], label=name) for name in names]
        drawn.legend(handles=handles, loc="outside upper left", ncols=len(names), frameon=False)
        drawn.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return text.getvalue()


def _draw(axes: Axes, panel: Panel, colour: Mapping[str, str]) -> None:
    for series in panel.series:
        end = [(panel.x[1], series.points[-1][1])] if series.steps and series.points else []
        x, y = zip(*series.points, *end, strict=True) if series.points else ((), ())
        axes.plot(x, y, color=colour[series.name], drawstyle="steps-post" if series.steps else "default")
    for value in panel.lines:
        axes.axvline(value, color="grey", linestyle="--", linewidth=1)
    axes.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label, xlim=panel.x, ylim=panel.y)
    if panel.logarithmic:
        axes.set_xscale("log")


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


def changes(record: Record, target: str) -> str:
    """Panels of one network: successes against queries and against p, without the columns of other settings."""
    cells = [cell for cell in _own(record, target)[0] if SETTING not in cell.attack]
    panels = (
        _success(cells, f"{title(target)}: success against queries", "queries", _by_queries(cells), 1.0),
        _success(cells, "Success against p", "p ×10⁻³", {c.attack: [(1000 * p, n) for p, n in c.by_p] for c in cells}),
    )
    return figure(panels, [cell.attack for cell in cells])


def around(record: Record, target: str) -> str:
    """A panel of one network: per cent of the objects that are fooled from more than a share of the views."""
    lines = []
    for attack in record.table().attacks:
        own = [job.around for job in record.jobs if (job.target, job.attack) == (target, attack)]
        shares = sorted(100 * seen.fooled / seen.right for seen in own if seen is not None and seen.right)
        reached = [(share, 100 * (1 - number / len(shares))) for number, share in enumerate(shares, 1)]
        lines.append(Series(attack, [(0.0, 100.0), *reached], steps=True))
    panel = Panel(
        title(target), "fooled from more than so many of the views, %", "objects, %", lines, (0, 100), (0, 102)
    )
    return figure([panel], [line.name for line in lines])


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
    return Panel(name, label, "verified, % of all cases", lines, ends, (0, 102), logarithmic=start > 0)


def _mean(curves: Sequence[MeanCurves], name: str, unit: str, of: str, ends: tuple[float, float]) -> Panel:
    """Mean curves up to the last step of all: cases that have ended keep their last value."""
    steps = max((len(curve.loss) for curve in curves), default=2) - 1
    lines = [
        Series(curve.attack, [*enumerate(getattr(curve, of)), (steps, getattr(curve, of)[-1])]) for curve in curves
    ]
    return Panel(name, "step", unit, lines, (0, steps), ends)
