"""The curves of the study: successes against work over all cases, and the paper's mean curves, as SVG."""

from collections.abc import Mapping, Sequence

from benchmarks.study.chart import Panel, Series, figure
from benchmarks.study.question_tables import attacks
from benchmarks.study.record import Record
from benchmarks.study.tables import title
from services.analysis.campaign_table import Cell, Corners, MeanCurves, corners


def differentiable(record: Record, target: str) -> str:
    """Of one network: successes against queries, successes against seconds, and the mean probability of the truth."""
    cells, curves = _own(record, target)
    steps = max((len(curve.loss) for curve in curves), default=2) - 1
    loss = Panel(
        "Mean probability of the right answer",
        "step",
        "over all cases",
        [_line(curve, curve.loss, steps) for curve in curves],
        (0, steps),
        (0, 1),
    )
    return figure([*_success(cells, target), loss], [cell.attack for cell in cells])


def questions(record: Record, target: str) -> str:
    """Of one network that answers questions, each attacked by itself: successes against steps, queries and p."""
    cells = [cell for cell in _own(record, target)[0] if cell.attack in attacks(record)]
    jobs = [job for job in record.jobs if job.target == target and job.success]
    by_step = {one.attack: [job.step or 0.0 for job in jobs if job.attack == one.attack] for one in cells}
    by_p = {one.attack: [1000 * (job.p or 0.0) for job in jobs if job.attack == one.attack] for one in cells}
    panels = (
        _linear(cells, f"{title(target)}: success against steps", "step", by_step),
        _success(cells, target)[0],
        _linear(cells, "Success against p", "p ×10⁻³", by_p),
    )
    return figure(panels, [cell.attack for cell in cells])


def _linear(cells: Sequence[Cell], name: str, unit: str, values: Mapping[str, Sequence[float]]) -> Panel:
    """Successes whose value, of a job, is at most that of the axis."""
    end = max((value for own in values.values() for value in own), default=1.0) or 1.0
    lines = []
    for cell in cells:
        points = [(at, 100 * count / cell.success.of) for at, count in corners(list(values[cell.attack]))]
        lines.append(Series(cell.attack, [(0.0, 0.0), *points], steps=True))
    return Panel(name, unit, "verified, % of all cases", lines, (0.0, 1.05 * end), (0.0, 100.0))


def nondifferentiable(record: Record, target: str) -> str:
    """Of one network: successes against queries, the mean advantage, and the mean distance, as the paper draws them."""
    cells, curves = _own(record, target)
    steps = max((len(curve.loss) for curve in curves), default=2) - 1
    top = max((max(curve.advantage) for curve in curves), default=1.0)
    bottom = min(0.0, min((min(curve.advantage) for curve in curves), default=0.0))
    far = max((max(curve.distance) for curve in curves), default=1.0)
    advantage = Panel(
        "Mean log-probability advantage",
        "step",
        "below 0: fooled",
        [_line(curve, curve.advantage, steps) for curve in curves],
        (0, steps),
        (bottom * 1.05, top * 1.05),
    )
    distance = Panel(
        "Mean distance of the image",
        "step",
        "‖ΔY‖₂",
        [_line(curve, curve.distance, steps) for curve in curves],
        (0, steps),
        (0, far * 1.05),
    )
    return figure([_success(cells, target)[0], advantage, distance], [cell.attack for cell in cells])


def _line(curve: MeanCurves, values: Sequence[float], steps: int) -> Series:
    """A mean curve up to the last step of all: cases that have ended keep their last value."""
    return Series(curve.attack, [*enumerate(values), (steps, values[-1])])


def _own(record: Record, target: str) -> tuple[list[Cell], list[MeanCurves]]:
    cells = [cell for cell in record.table().cells if cell.target == target and cell.success.of]
    return cells, [curve for curve in record.curves if curve.target == target]


def _success(cells: Sequence[Cell], target: str) -> tuple[Panel, Panel]:
    """Panels of successes against queries and against seconds."""
    name = f"{title(target)}: success against queries"
    return (
        _against(cells, name, "queries", "by_queries", 1.0),
        _against(cells, "Success against seconds", "seconds", "by_seconds", 0.1),
    )


def _against(cells: Sequence[Cell], name: str, unit: str, curve: str, start: float) -> Panel:
    corners: dict[str, Corners] = {cell.attack: getattr(cell, curve) for cell in cells}
    end = max((at for own in corners.values() for at, _ in own), default=10.0 * start)
    lines = []
    for cell in cells:
        points = [(at, 100 * count / cell.success.of) for at, count in corners[cell.attack]]
        lines.append(Series(cell.attack, [(start, 0.0), *points], steps=True))
    return Panel(
        name,
        f"{unit} (logarithmic)",
        "verified, % of all cases",
        lines,
        (start, max(end * 1.1, 10 * start)),
        (0, 100),
        logarithmic=True,
    )
