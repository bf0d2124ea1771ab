"""Output: tables and progress for people, JSON for machines. Results go to stdout, all else to stderr."""

import json
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text


def out() -> Console:
    """The console of results. Wide where there is no terminal, so that no column of a log is cut."""
    return Console(width=None if sys.stdout.isatty() else 200)


def err() -> Console:
    """The console of progress and remarks."""
    return Console(stderr=True, width=None if sys.stderr.isatty() else 200)


def report_extensions() -> None:
    """Says on stderr which extensions were left out, and why."""
    from services.pipeline.extensions import EXTENSIONS

    for one in EXTENSIONS:
        if one.error is not None:
            err().print(f"extension left out: {one.path}: {one.error}", markup=False, highlight=False)


def print_json(data: Any) -> None:
    """One JSON document on stdout."""
    print(json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False))


def table(columns: Iterable[str], rows: Iterable[Iterable[str | Text]], *, title: str | None = None) -> Table:
    """A table; columns whose heading ends in ">" are aligned to the right. Cells are plain text, never markup."""
    made = Table(title=title, title_justify="left", header_style="bold")
    for column in columns:
        made.add_column(column.removesuffix(">"), justify="right" if column.endswith(">") else "left", overflow="fold")
    for row in rows:
        made.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    return made


STATE_STYLES = {"succeeded": "green", "failed": "red", "cancelled": "yellow", "running": "cyan", "cancelling": "yellow"}


def state_text(state: str) -> Text:
    """The state of a job, coloured."""
    return Text(state, style=STATE_STYLES.get(state, ""))


def answer_text(answer: Mapping[str, Any] | None) -> str:
    """A label and its confidence: "grand piano 0.77"."""
    return "" if answer is None else f"{answer['label']} {answer['confidence']:.2f}"


def small(value: float | str) -> str:
    """An error or a tolerance: "8.0e-04", "0"; words as they are."""
    return value if isinstance(value, str) else f"{value:.1e}" if value else "0"


def yes(value: bool | None) -> Text:
    """The word "yes" in green, "no" in yellow, nothing for None."""
    return Text("") if value is None else Text("yes", style="green") if value else Text("no", style="yellow")
