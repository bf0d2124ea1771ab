"""The cases of a campaign with what they are about: a line for each job, and tables of any two of its fields."""

import csv
import io
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from services.analysis.campaign_table import Case, Rate, mean
from services.analysis.campaign_text import plain

FIELDS = ("scene", "azimuth", "truth", "first answer", "target", "attack", "seed")
"""What a row or a column of a grid may stand for."""
MEASURES = ("success", "perceptibility", "queries", "seconds")
"""What a cell of a grid may show: the rate of success over its cases, or a mean over its successes."""
_OF_CASE = (
    "state",
    "right",
    "outcome",
    "epsilon_bound",
    "success",
    "loop_success",
    "perceptibility",
    "loop_perceptibility",
    "truncated",
)
_WORK = ("queries", "seconds", "run_seconds", "reused")


@dataclass(frozen=True)
class CaseRow:
    """A job of a campaign that has ended: its number, its id if it was not deleted, and its fields as text."""

    number: int
    job: str | None
    fields: Mapping[str, str]
    case: Case

    @property
    def counted(self) -> bool:
        """Whether the table counts it: the first answer was right, and it was not cancelled."""
        return self.case.right and self.case.state != "cancelled"


@dataclass(frozen=True)
class GridCell:
    """The counted cases of a row and a column, and the measure; None where no case has it."""

    success: Rate
    value: float | None
    share: float
    """Where `value` lies between the smallest (0) and the largest (1) of the grid; of rates, the rate itself."""


@dataclass(frozen=True)
class Grid:
    """The measure by two fields. `cells` has a cell for each pair that has counted cases."""

    rows: list[str]
    columns: list[str]
    cells: dict[tuple[str, str], GridCell]


def grid(cases: Sequence[CaseRow], row: str, column: str, measure: str) -> Grid:
    """The measure, one of MEASURES, by two of FIELDS. Rows and columns are in the order in which they first occur, but
    numbers in their own.
    """
    found: dict[tuple[str, str], list[Case]] = defaultdict(list)
    for one in cases:
        if one.counted:
            found[one.fields[row], one.fields[column]].append(one.case)
    rates = {at: Rate.of_cases(sum(case.success for case in own), len(own)) for at, own in found.items()}
    values = {
        at: rates[at].rate if measure == "success" else mean([getattr(case, measure) for case in own if case.success])
        for at, own in found.items()
    }
    there = [value for value in values.values() if value is not None]
    low, high = (0.0, 1.0) if measure == "success" or not there else (min(there), max(there))
    return Grid(
        rows=_ordered([at for at, _ in found]),
        columns=_ordered([at for _, at in found]),
        cells={at: GridCell(rates[at], value, _share(value, low, high)) for at, value in values.items()},
    )


def _share(value: float | None, low: float, high: float) -> float:
    return 0.0 if value is None or high <= low else (value - low) / (high - low)


def _ordered(labels: Sequence[str]) -> list[str]:
    different = list(dict.fromkeys(labels))
    try:
        return sorted(different, key=lambda label: float(label.rstrip("°")))
    except ValueError:
        return different


def best(cases: Sequence[CaseRow], count: int) -> list[CaseRow]:
    """The successes that changed the image least, by p."""
    won = [one for one in cases if one.counted and one.case.success]
    return sorted(won, key=lambda one: (one.case.perceptibility or 0.0, one.number))[:count]


def worst(cases: Sequence[CaseRow], count: int) -> list[CaseRow]:
    """The counted cases that held longest, by queries; if they are too few, the successes that changed the image most
    follow.
    """
    held = [one for one in cases if one.counted and not one.case.success]
    won = [one for one in cases if one.counted and one.case.success]
    held.sort(key=lambda one: (-(one.case.queries or 0), one.number))
    won.sort(key=lambda one: (-(one.case.perceptibility or 0.0), one.number))
    return [*held, *won][:count]


def to_csv(cases: Sequence[CaseRow]) -> str:
    """One line for each job that has ended; p in full range, empty where unknown."""
    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(["number", "job", *(name.replace(" ", "_") for name in FIELDS), *_OF_CASE, *_WORK])
    for one in cases:
        values = [getattr(one.case, name) for name in (*_OF_CASE, *_WORK)]
        lines.writerow(
            [plain(value) for value in (one.number, one.job, *(one.fields[name] for name in FIELDS), *values)]
        )
    return out.getvalue()
