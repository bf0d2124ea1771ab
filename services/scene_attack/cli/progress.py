"""Shows a running job on the terminal: a progress line, or, without a terminal, a new line every few seconds."""

from collections.abc import Mapping
from time import monotonic
from types import TracebackType
from typing import Any, Self

from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from scene_attack.cli.console import err, remark

LOG_EVERY = 5.0
"""Seconds between two lines of a log."""


class ProgressLine:
    """Base class of progress lines: a bar on a terminal; without one, `_logs` says that lines are printed."""

    def __init__(self, name: str) -> None:
        console = err()
        self._logs = not console.is_terminal
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[now]}"),
            console=console,
            disable=self._logs,
        )
        self._task = self._bar.add_task(name, total=None, now="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()


class JobLine(ProgressLine):
    """Shows the progress of one job."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._name = name
        self._logged: tuple[str, float] = ("", 0.0)

    def update(self, phase: str, step: int, steps: int, row: Mapping[str, Any] | None) -> None:
        """Shows the progress of the job; `row` is the newest row of its trace, while attacking."""
        now = phase if row is None else row_text(row)
        self._bar.update(self._task, completed=step, total=steps, now=now)
        if self._logs and (phase != self._logged[0] or monotonic() - self._logged[1] > LOG_EVERY):
            self._logged = (phase, monotonic())
            remark(f"{self._name}: {phase} {step}/{steps}  {row_text(row) if row else ''}")


def row_text(row: Mapping[str, Any]) -> str:
    """A row of the trace as text: answer, confidence, perceptibility, queries."""
    return f"{row['label']} {row['confidence']:.2f}  p {row['perceptibility'] * 1000:.1f}e-3  {row['queries']} queries"
