"""Formats campaigns and their tables for the terminal."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from client.console import table
from client.fitted_table import FittedTable

STYLES = {"finished": "green", "running": "cyan", "selecting": "cyan", "paused": "yellow", "cancelled": "yellow"}


def campaign_state(state: str) -> Text:
    """The state of a campaign, in its colour."""
    return Text(state, style=STYLES.get(state, "red"))


def results(found: Mapping[str, Any]) -> FittedTable:
    """The table of a campaign (services.analysis.campaign_table.Table, as JSON): a row for each target and attack."""
    columns = ("target", "attack", "ended>", "n>", "success %>", "95 % interval>", "p ×1e-3>", "held within ε>")
    loop = ("in the loop %>", "p in the loop ×1e-3>", "truncated px>", "failed>", "reused>")
    spare = ("reused", "held within ε", "truncated px", "failed", "in the loop %", "ended", "n")
    return table((*columns, *loop), [_row(cell) for cell in found["cells"]], title=found["campaign"], spare=spare)


def _row(cell: Mapping[str, Any]) -> list[str | Text]:
    success = cell["success"]
    interval = "" if success["rate"] is None else f"{100 * success['low']:.1f}–{100 * success['high']:.1f}"
    return [
        cell["target"],
        cell["attack"],
        f"{cell['ended']}/{cell['jobs']}",
        str(success["of"]),
        _number(success["rate"], 100),
        interval,
        _number(cell["perceptibility"], 1000),
        str(cell["held_within_epsilon"] or ""),
        _number(cell["loop_success"]["rate"], 100),
        _number(cell["loop_perceptibility"], 1000),
        _number(cell["truncated"], 1),
        str(cell["failed"] or ""),
        str(cell["reused"] or ""),
    ]


def _number(value: float | None, factor: float) -> str:
    return "" if value is None else f"{value * factor:.1f}"


def duration(seconds: float | None) -> str:
    """A time in words, e.g. "1 h 05 min", "3 min" or "20 s"; empty for None."""
    if seconds is None:
        return ""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"
