"""Output of the command line: tables and plain lines, or JSON. Results go to stdout, everything else to stderr."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from scene_attack.text import escaped, visible

if TYPE_CHECKING:
    from scene_attack.analysis.records import Answer, Said


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


def say(*shown: RenderableType) -> None:
    """Prints results on stdout: tables, and lines of plain text, which are never broken."""
    _print(out(), shown)


def remark(*shown: RenderableType) -> None:
    """Prints progress and remarks on stderr, as `say` does."""
    _print(err(), shown)


def _print(console: Console, shown: Iterable[RenderableType]) -> None:
    for part in shown:
        console.print(part, markup=False, highlight=False, soft_wrap=isinstance(part, str))


def print_json(data: Any) -> None:
    """Prints data, which may be or hold models, as one JSON document on stdout. ValueError for a number that is not
    finite.
    """
    print(escaped(json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False, default=_of_model)))


def _of_model(model: Any) -> Any:
    return model.model_dump(mode="json")


def print_found(found: Any, shown: RenderableType, as_json: bool) -> None:
    """Prints the result `found` of a command as JSON if `as_json`, else `shown`."""
    if as_json:
        print_json(found)
    else:
        say(shown)


Row = Iterable[str | Text]
MAX_WORD = 40
"""Characters of a word that a column makes room for; a longer one, such as a hash, is broken."""


class FittedTable:
    """A table of cells of plain text; a column whose heading ends in ">" is aligned to the right.

    Cells are never markup. Where the words of the columns do not fit side by side, a table of one row becomes a list of
    its fields, and one of several rows loses columns from `spare`, the first ones first, and says below which.
    """

    def __init__(
        self, columns: Iterable[str], rows: Iterable[Row], *, title: str | None = None, spare: Sequence[str] = ()
    ) -> None:
        self.columns = list(columns)
        self.rows = [list(row) for row in rows]
        self.title = title
        self.spare = spare

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Rich's protocol."""
        table, left_out = _table(self.columns, self.rows, self.title), list[str]()
        if len(self.rows) == 1 and not _fits(table, console, options):
            fields = [[name.removesuffix(">"), cell] for name, cell in zip(self.columns, self.rows[0], strict=True)]
            yield _table(["", ""], fields, self.title)
            return
        for name in self.spare:
            if _fits(table, console, options):
                break
            left_out.append(name.removesuffix(">"))
            kept = [at for at, column in enumerate(self.columns) if column.removesuffix(">") not in left_out]
            columns, rows = [self.columns[at] for at in kept], [[row[at] for at in kept] for row in self.rows]
            table = _table(columns, rows, self.title)
        yield table
        if left_out:
            yield Text(f"A wider terminal also shows: {', '.join(left_out)}.", style="dim")


def _fits(table: Table, console: Console, options: ConsoleOptions) -> bool:
    # What the words need side by side, which rich itself cuts at the width of the console.
    wide = options.update(max_width=10_000)
    return Measurement.get(console, wide, table).minimum <= options.max_width


def _table(columns: Sequence[str], rows: Sequence[Sequence[str | Text]], title: str | None) -> Table:
    table = Table(title=title, title_justify="left", header_style="bold", show_header=any(columns))
    for at, column in enumerate(columns):
        words = " ".join([column.removesuffix(">"), *(str(row[at]) for row in rows)]).split()
        table.add_column(
            column.removesuffix(">"),
            justify="right" if column.endswith(">") else "left",
            overflow="fold",
            min_width=min(max(map(len, words), default=1), MAX_WORD),  # rich breaks words to widen other columns
        )
    for row in rows:
        table.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    return table


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


def yes(value: bool | None) -> Text:
    """The word "yes" in green, "no" in yellow, nothing for None."""
    return Text("") if value is None else Text("yes", style="green") if value else Text("no", style="yellow")


def report_plugins() -> None:
    """Prints on stderr the plug-ins that were left out, with the reasons."""
    from scene_attack.plugins import loaded_plugins

    for plugin in loaded_plugins():
        if plugin.error is not None:
            remark(f"plug-in left out: {plugin.name} ({plugin.package}): {plugin.error}")


def report_targets() -> None:
    """Prints on stderr the folders of networks that were left out. A request that names one is told the reason."""
    from scene_attack.runs.set_up import target_folders

    for folder in target_folders():
        if folder.error is not None:
            remark(f"target left out: {folder.name}: {folder.error}")
