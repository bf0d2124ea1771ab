"""Tables of measurements: in Markdown, of every page that is written from a result, and as data."""

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

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


def rows_as_json(parts: Mapping[str, Any]) -> str:
    """An object as JSON with a line for each row of a part that is a list, so that two results can be compared."""
    texts = []
    for name, part in parts.items():
        rows = part if isinstance(part, list) else [part]
        lines = ",\n  ".join(json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows)
        texts.append(f' "{name}": ' + (f"[\n  {lines}\n ]" if isinstance(part, list) else lines))
    return "{\n" + ",\n".join(texts) + "\n}\n"
