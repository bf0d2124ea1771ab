"""Tables in Markdown, and the cells of the work-precision report's."""

from collections.abc import Iterable, Iterator, Sequence

from services.accuracy.work_precision.timing import Times


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Columns whose heading ends in ">" are aligned to the right."""
    yield "| " + " | ".join(column.removesuffix(">") for column in columns) + " |"
    yield "|" + "|".join("---:" if column.endswith(">") else "---" for column in columns) + "|"
    for row in rows:
        yield "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |"


def grid(texels: tuple[int, int]) -> str:
    """Rows and columns of a map."""
    return f"{texels[0]}×{texels[1]}"


def small(value: float | str | None) -> str:
    """An error or a tolerance; nothing for None."""
    if value is None or isinstance(value, str):
        return value or ""
    return f"{value:.1e}" if value else "0"


def brief(value: float | None) -> str:
    """Seconds or a number of queries; nothing for None."""
    return "" if value is None else f"{value:.2g}" if value < 10 else f"{value:.0f}"


def quartiles(times: Times | None) -> str:
    """Median and quartiles of seconds; nothing for None."""
    return "" if times is None else f"{times.median:.2g} [{times.lower:.2g}–{times.upper:.2g}]"
