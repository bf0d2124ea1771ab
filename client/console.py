"""Output of the command line: tables and progress, or JSON. Results go to stdout, everything else to stderr."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from client.fitted_table import FittedTable
from services.text import escaped, visible

if TYPE_CHECKING:
    from services.analysis.records import Answer, Said


class PlainConsole(Console):
    """A console that shows a replacement character for each that would steer the terminal: services may send any."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """The pieces of what is printed."""
        for piece in super().render(renderable, options):
            yield piece if piece.control else Segment(visible(piece.text), piece.style)


def out() -> Console:
    """The console of results, on stdout. Without a terminal it is 200 columns wide, so that no column is cut."""
    return PlainConsole(width=None if sys.stdout.isatty() else 200)


def err() -> Console:
    """The console of progress and remarks, on stderr."""
    return PlainConsole(stderr=True, width=None if sys.stderr.isatty() else 200)


def report_extensions() -> None:
    """Prints on stderr the extensions that were left out, with the reasons."""
    from services.errors import printable
    from services.pipeline.extensions import loaded_extensions

    for extension in loaded_extensions():
        if extension.error is not None:
            file = printable(str(extension.path))
            err().print(f"extension left out: {file}: {extension.error}", markup=False, highlight=False)


def report_targets() -> None:
    """Prints on stderr the folders of networks that were left out. A request that names one is told the reason."""
    from services.pipeline.extensions import target_folders

    for folder in target_folders():
        if folder.error is not None:
            err().print(f"target left out: {folder.name}: {folder.error}", markup=False, highlight=False)


def print_json(data: Any) -> None:
    """Prints data, which may be a model, as one JSON document on stdout. ValueError for a number that is not finite."""
    if hasattr(data, "model_dump"):
        data = data.model_dump(mode="json")
    print(escaped(json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)))


def table(
    columns: Iterable[str],
    rows: Iterable[Iterable[str | Text]],
    *,
    title: str | None = None,
    spare: Sequence[str] = (),
) -> FittedTable:
    """A table that fits the terminal; columns whose heading ends in ">" are aligned to the right.

    Cells are plain text, never markup. `spare` are the columns that a narrow terminal does not show, in their order.
    """
    return FittedTable(list(columns), [list(row) for row in rows], title=title, spare=spare)


STATE_STYLES = {
    "succeeded": "green",
    "failed": "red",
    "rejected": "red",
    "cancelled": "yellow",
    "running": "cyan",
    "cancelling": "yellow",
}


def state_text(state: str) -> Text:
    """The state of a job, in its colour."""
    return Text(state, style=STATE_STYLES.get(state, ""))


def answer_text(answer: "Answer | Said") -> str:
    """A label and its confidence, e.g. "grand piano 0.77"."""
    return f"{answer.label} {answer.confidence:.2f}"


def small(value: float | str) -> str:
    """An error or a tolerance, e.g. "8.0e-04" or "0"; the tolerance "exact" stays as it is."""
    return value if isinstance(value, str) else f"{value:.1e}" if value else "0"


def yes(value: bool | None) -> Text:
    """The word "yes" in green, "no" in yellow, nothing for None."""
    return Text("") if value is None else Text("yes", style="green") if value else Text("no", style="yellow")
