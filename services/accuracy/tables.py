"""Tables of measurements in Markdown, of every page that is written from a result."""

from collections.abc import Callable, Iterable, Mapping
from typing import TypeVar

Row = TypeVar("Row")


def table(columns: Mapping[str, Callable[[Row], str]], rows: Iterable[Row]) -> str:
    """A table of rows. `columns` gives for each heading, as in `markdown`, the function that writes a row's cell."""
    return markdown(columns, ([cell(row) for cell in columns.values()] for row in rows))


def markdown(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table of cells, line by line. A column whose heading ends in ">" is aligned to the right."""
    headings = list(headings)
    rule = ["---:" if heading.endswith(">") else ":---" for heading in headings]
    lines = [[heading.removesuffix(">") for heading in headings], rule]
    lines += [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def small(value: float | None) -> str:
    """An error with two digits; empty for None."""
    return "" if value is None else f"{value:.1e}" if value else "0"
