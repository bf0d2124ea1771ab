"""The curves of a campaign as a PNG, drawn with matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scene_attack.analysis.campaign_table import Cell, Corners, MeanCurves, Table

LABELS = {"loss": "mean loss", "advantage": "mean log-probability advantage", "distance": "mean distance ‖ΔY‖₂"}
COLOURS = ("#4a2fd6", "#0a5a94", "#0b6b3a", "#b26a00", "#a3182f", "#8b1a86", "#5d5875", "#1c1930")
"""Colours of the attacks, in the order of the table: those of the dashboard on a white page."""
PANEL = (4.2, 3.2)
"""Width and height of one panel, inches."""
STYLE: dict[Any, Any] = {"font.size": 8, "axes.grid": True, "grid.alpha": 0.3}


def draw(table: Table, curves: Sequence[MeanCurves], path: Path) -> None:
    """Writes a PNG with a row for each target: success against queries and seconds, and the mean curves by step.

    Of a campaign that attacks no view, the row is empty.
    """
    with mpl.rc_context(STYLE):
        rows, columns = max(1, len(table.targets)), 2 + len(LABELS)
        figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for target, row in zip(table.targets, axes[: len(table.targets)], strict=True):
            own_cells = [cell for cell in table.cells if cell.target == target and cell.success.of]
            for panel, along in zip(row[:2], ("queries", "seconds"), strict=True):
                _success(panel, target, along, own_cells)
            for panel, (measure, label) in zip(row[2:], LABELS.items(), strict=True):
                of_target = [curve for curve in curves if curve.target == target]
                _mean(
                    panel, target, label, [(curve.attack, curve.cases, getattr(curve, measure)) for curve in of_target]
                )
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110, metadata={"Software": None})  # the same bytes with every version's name


def _success(axes: Axes, target: str, along: str, cells: Sequence[Cell]) -> None:
    """Draws success up to the longest case, fooled or not: a shorter axis would hide attacks that gave up later."""
    end = max((getattr(cell, f"most_{along}") or 0.0 for cell in cells), default=0.0) * 1.05 or 1.0
    axes.set_prop_cycle(color=COLOURS)
    for cell in cells:
        curve: Corners = getattr(cell, f"by_{along}")
        steps = [(0.0, 0), *curve, (end, curve[-1][1] if curve else 0)]
        shares = [100 * count / cell.success.of for _, count in steps]
        axes.step([at for at, _ in steps], shares, where="post", label=f"{cell.attack} (n = {cell.success.of})")
    axes.set(title=target, xlabel=along, ylabel="verified successes, % of all cases", ylim=(-2, 102), xlim=(0, end))
    if cells:
        axes.legend()


def _mean(axes: Axes, target: str, label: str, curves: Sequence[tuple[str, int, Sequence[float]]]) -> None:
    axes.set_prop_cycle(color=COLOURS)
    for attack, cases, values in curves:
        axes.plot(range(len(values)), values, label=f"{attack} (n = {cases})")
    axes.set(title=target, xlabel="step", ylabel=label)
    if curves:
        axes.legend()
