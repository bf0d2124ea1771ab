"""The cases of a campaign on its page: best and worst ones, a heat map of any two fields, and which part mattered."""

from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import urlencode

from services.analysis.case_rows import FIELDS, MEASURES, CaseRow, Grid, best, grid, worst
from services.analysis.mean_attribution import PartMean, part_means
from services.jobs.campaign_service import CampaignService
from services.jobs.models import Campaign

SHOWN = 6
"""Number of best and of worst cases."""
OPENED = 24
"""Largest number of cases that an opened cell shows."""
ATTRIBUTED = 500
"""Largest number of jobs whose attribution is read."""
SHADES = 8


@dataclass(frozen=True)
class Square:
    """A cell of the heat map: its text, what it counts, its shade from 0 to SHADES, and the address that opens it."""

    text: str
    count: str
    shade: int
    address: str
    open: bool


@dataclass(frozen=True)
class Choice:
    """What the heat map shows: the fields of its rows and columns, the measure, and the cell that is opened, if any."""

    rows: str = "scene"
    columns: str = "attack"
    measure: str = "success"
    row: str | None = None
    column: str | None = None

    def valid(self) -> "Choice":
        """This choice, with what there is not replaced by the default."""
        return Choice(
            self.rows if self.rows in FIELDS else "scene",
            self.columns if self.columns in FIELDS else "attack",
            self.measure if self.measure in MEASURES else "success",
            self.row,
            self.column,
        )


@dataclass(frozen=True)
class Cases:
    """The data of the part of the page that is about single cases."""

    choice: Choice
    grid: Grid
    squares: list[tuple[str, list[Square | None]]]
    """The rows of the heat map."""
    opened: list[CaseRow]
    opened_of: int
    best: list[CaseRow]
    worst: list[CaseRow]
    parts: list[PartMean]
    most: float
    """The largest absolute mean of `parts`."""
    fields: tuple[str, ...] = FIELDS
    measures: tuple[str, ...] = MEASURES


def cases(service: CampaignService, campaign: Campaign, choice: Choice) -> Cases:
    """The cases of a campaign, which must have been read whole, as `choice` asks."""
    rows, choice = service.cases(campaign), choice.valid()
    made = grid(rows, choice.rows, choice.columns, choice.measure)
    parts = part_means(service.record.attributions(campaign.id, ATTRIBUTED))
    opened = [one for one in rows if _is_in(one, choice)]
    return Cases(
        choice=choice,
        grid=made,
        squares=[(row, [_square(campaign.id, made, choice, row, one) for one in made.columns]) for row in made.rows],
        opened=opened[:OPENED],
        opened_of=len(opened),
        best=best(rows, SHOWN),
        worst=worst(rows, SHOWN),
        parts=parts,
        most=max((abs(one.value) for one in parts), default=0.0),
    )


def _is_in(one: CaseRow, choice: Choice) -> bool:
    return one.counted and (one.fields[choice.rows], one.fields[choice.columns]) == (choice.row, choice.column)


def _square(campaign: str, made: Grid, choice: Choice, row: str, column: str) -> Square | None:
    cell = made.cells.get((row, column))
    if cell is None:
        return None
    asked = {"rows": choice.rows, "columns": choice.columns, "measure": choice.measure, "row": row, "column": column}
    return Square(
        text=written(cell.value, choice.measure),
        count=f"{cell.success.count}/{cell.success.of}",
        shade=round(SHADES * cell.share) if cell.value is not None else 0,
        address=f"/campaigns/{campaign}?{urlencode(asked)}#opened",
        open=(row, column) == (choice.row, choice.column),
    )


def written(value: float | None, measure: str) -> str:
    """A value of a measure as text: a rate in per cent, p in thousandths, queries and seconds with three digits."""
    if value is None:
        return "–"
    if measure == "success":
        return f"{value:.0%}"
    return (
        f"{1000 * value:.2f}" if measure == "perceptibility" else f"{value:,.3g}" if value < 1000 else f"{value:,.0f}"
    )


def steps(values: Sequence[tuple[float, int]], of: int, most: int = 20) -> list[tuple[float, int, float]]:
    """At most `most` corners of a step curve, evenly chosen, with the share of `of` cases; the last one is kept."""
    if not values or not of:
        return []
    stride = max(1, -(-len(values) // most))
    kept = [*values[:-1:stride], values[-1]]
    return [(at, count, count / of) for at, count in kept]
