"""A table that fits the width of the terminal without breaking words."""

from collections.abc import Sequence

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

Row = Sequence[str | Text]
MOST = 40
"""Characters of a word that a column makes room for; a longer one, such as a hash, is broken."""


class FittedTable:
    """A table of cells of plain text; a column whose heading ends in ">" is aligned to the right.

    Where the words of the columns do not fit side by side, a table of one row becomes a list of its fields, and one of
    several rows loses columns from `spare`, the first ones first, and says below which.
    """

    def __init__(
        self, columns: Sequence[str], rows: Sequence[Row], *, title: str | None = None, spare: Sequence[str] = ()
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


def _table(columns: Sequence[str], rows: Sequence[Row], title: str | None) -> Table:
    made = Table(title=title, title_justify="left", header_style="bold", show_header=any(columns))
    for at, column in enumerate(columns):
        words = " ".join([column.removesuffix(">"), *(str(row[at]) for row in rows)]).split()
        made.add_column(
            column.removesuffix(">"),
            justify="right" if column.endswith(">") else "left",
            overflow="fold",
            min_width=min(max(map(len, words), default=1), MOST),  # rich would break words of one column for another
        )
    for row in rows:
        made.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    return made
