"""The dashboard's pages about campaigns: the list, and one campaign with its curves and its cases.

The cases are shown as the best and the worst, as a heat map of any two fields, and by the parts that mattered.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import RedirectResponse

from scene_attack.analysis.campaign_table import (
    CASE_FIELDS,
    GRID_MEASURES,
    CaseRow,
    Cell,
    Corners,
    Grid,
    best,
    grid,
    part_means,
    worst,
)
from scene_attack.errors import InvalidRequest
from scene_attack.runs.campaign_plan import nothing_chosen
from scene_attack_api.cursors import campaign_cursor, read_campaign_cursor
from scene_attack_api.dashboard.charts import Chart, chart
from scene_attack_api.dashboard.pages import HEADERS, html, part_of
from scene_attack_api.requests import CallerDependency, ServicesDependency, no_such
from scene_attack_api.routes.campaigns import WholeCampaign
from scene_attack_service.jobs.campaigns import Campaigns
from scene_attack_service.jobs.models import Campaign, CampaignState

CASES_SHOWN = 6
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
    """Choices for the heat map: fields of its rows and columns, the measure, and the cell that is opened, if any."""

    rows: str = "scene"
    columns: str = "attack"
    measure: str = "success"
    row: str | None = None
    column: str | None = None

    def valid(self) -> "Choice":
        """This choice, with what there is not replaced by the default."""
        return Choice(
            self.rows if self.rows in CASE_FIELDS else "scene",
            self.columns if self.columns in CASE_FIELDS else "attack",
            self.measure if self.measure in GRID_MEASURES else "success",
            self.row,
            self.column,
        )


def cases(record: Campaigns, campaign: Campaign, choice: Choice) -> dict[str, Any]:
    """Data of the page about single cases of a campaign, which must have been read whole, as `choice` asks."""
    rows, choice = record.case_rows(campaign), choice.valid()
    heat_map = grid(rows, choice.rows, choice.columns, choice.measure)
    parts = part_means(record.attributions(campaign.id, ATTRIBUTED))
    opened = [case for case in rows if _is_in(case, choice)]
    return {
        "choice": choice,
        "fields": CASE_FIELDS,
        "measures": GRID_MEASURES,
        "grid": heat_map,
        "squares": [
            (row, [_square(campaign.id, heat_map, choice, row, column) for column in heat_map.columns])
            for row in heat_map.rows
        ],
        "opened": opened[:OPENED],
        "opened_of": len(opened),
        "best": best(rows, CASES_SHOWN),
        "worst": worst(rows, CASES_SHOWN),
        "parts": parts,
        "most": max((abs(part.value) for part in parts), default=0.0),
    }


def _is_in(case: CaseRow, choice: Choice) -> bool:
    return case.counted and (case.fields[choice.rows], case.fields[choice.columns]) == (choice.row, choice.column)


def _square(campaign: str, heat_map: Grid, choice: Choice, row: str, column: str) -> Square | None:
    cell = heat_map.cells.get((row, column))
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


Along = Literal["queries", "seconds", "p"]
ALONG: dict[Along, str] = {"queries": "queries", "seconds": "seconds", "p": "p ×10⁻³"}
"""Quantities against which the curves are drawn, with the words for them."""


def corners(cell: Cell, along: Along) -> Corners:
    """The corners of a cell's curve; p is in thousandths."""
    in_thousandths = [(1000 * p, count) for p, count in cell.by_p]
    return {"queries": cell.by_queries, "seconds": cell.by_seconds, "p": in_thousandths}[along]


def end(cell: Cell, along: Along) -> float:
    """End of a cell's curve: the most work of any case, or the greatest p of a success in thousandths; 0 if none."""
    most_p = 1000 * cell.by_p[-1][0] if cell.by_p else None
    return {"queries": cell.most_queries, "seconds": cell.most_seconds, "p": most_p}[along] or 0.0


def points(cell: Cell, along: Along, until: float) -> list[tuple[float, float]]:
    """The step curve of a cell with cases as points (work, share of the cases in per cent), up to the work `until`."""
    curve, share = [(0.0, 0.0)], 0.0
    for at, count in corners(cell, along):
        curve.append((at, share))
        share = 100 * count / cell.success.of
        curve.append((at, share))
    return [*curve, (until, share)]


PAGE = 30
"""Number of campaigns on one page of the list."""
VIEWS_SHOWN = 200
"""Largest number of views that a page lists."""

Field = Annotated[str, Query(max_length=300)]

router = APIRouter(include_in_schema=False)


@router.get("/campaigns")
@router.get("/parts/campaigns")
def campaigns(
    request: Request,
    services: ServicesDependency,
    caller: CallerDependency,
    state: CampaignState | None = None,
    cursor: Annotated[str | None, Query(max_length=200)] = None,
) -> Response:
    """The list of campaigns, newest first."""
    try:
        before = None if cursor is None else read_campaign_cursor(cursor)
    except InvalidRequest:
        before = None
    record = services.record.campaigns
    rows = record.page(state, PAGE + 1, before, owner=caller.only)
    older = campaign_cursor(rows[PAGE - 1]) if len(rows) > PAGE else None
    progress = record.progress([row.id for row in rows])
    lines = [(row, progress[row.id]) for row in rows[:PAGE]]
    template = part_of(request, "campaigns.html")
    return html(template, caller=caller, lines=lines, state=state, cursor=cursor, older=older)


@router.get("/campaigns/{campaign_id}")
@router.get("/parts/campaigns/{campaign_id}")
def campaign(
    stored: WholeCampaign,
    request: Request,
    services: ServicesDependency,
    caller: CallerDependency,
    rows: Field = "scene",
    columns: Field = "attack",
    measure: Field = "success",
    row: Field | None = None,
    column: Field | None = None,
) -> Response:
    """The page of one campaign, with a heat map of two fields, which its script does not reload; `row` and `column`
    open a cell of it.
    """
    result = services.record.campaigns.result(stored, curves=False)
    attacked = sorted(result.views, key=lambda view: not view.chosen)
    cells = [cell for cell in result.table.cells if cell.success.of]
    values: dict[str, Any] = {
        "campaign": stored,
        "progress": services.record.campaigns.progress([stored.id])[stored.id],
        "counts": services.campaign_counts(stored.id),
        "table": result.table,
        "charts": {along: _charts(cells, along) for along in ALONG},
        # The curves as a table: work, successes, and their share.
        "curves": [
            (cell, ALONG[along], steps(corners(cell, along), cell.success.of)) for along in ALONG for cell in cells
        ],
        "views": attacked[:VIEWS_SHOWN],
        "chosen": sum(view.chosen for view in result.views),
        "why_none": nothing_chosen(result.views) if stored.selected_at else None,
    }
    template = part_of(request, "campaign.html")
    if template == "campaign.html":
        choice = Choice(rows, columns, measure, row, column)
        values["cases"] = cases(services.record.campaigns, stored, choice)
    return html(template, caller=caller, **values)


@router.post("/campaigns/{campaign_id}/{move}")
def move(campaign_id: str, move: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Pauses, resumes or cancels a campaign, as the buttons on its page ask, and redirects to the page."""
    record = services.record.campaigns
    moves = {"pause": record.pause, "resume": record.resume, "cancel": record.cancel}
    if move not in moves or caller.visible(record.get(campaign_id)) is None:
        raise no_such("campaign")
    moves[move](campaign_id)
    return RedirectResponse(f"/campaigns/{campaign_id}", 303, HEADERS)


def _charts(cells: Sequence[Cell], along: Along) -> list[Chart]:
    """The step curves of the verified successes of cells that have cases, all as far as any case went."""
    until = 1.05 * (max((end(cell, along) for cell in cells), default=0.0) or 1.0)
    return [
        chart(
            f"{cell.attack}, {cell.target}: verified successes, % of {cell.success.of}",
            ALONG[along],
            points(cell, along, until),
            include=(0, 100),
        )
        for cell in cells
    ]
