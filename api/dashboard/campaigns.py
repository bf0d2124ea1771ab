"""Routes of the dashboard's pages about campaigns."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import RedirectResponse

from api.authentication import CallerDependency
from api.dashboard.campaign_cases import Choice, cases, steps
from api.dashboard.campaign_curves import ALONG, Along, corners, end, points
from api.dashboard.charts import Chart, chart
from api.dashboard.pages import HEADERS, html
from api.schemas import cursor_after, read_cursor
from api.state import Services, ServicesDependency, no_such
from services.access.caller import Caller
from services.analysis.campaign_table import Cell, Table
from services.errors import InvalidRequest
from services.jobs.campaign_service import Counts
from services.jobs.campaigns import Progress
from services.jobs.models import Campaign, CampaignState
from services.pipeline.campaign_select import ChosenView, nothing_chosen

PAGE = 30
"""Number of campaigns on one page of the list."""
SHOWN = 200
"""Largest number of views that a page lists."""

Field = Annotated[str, Query(max_length=300)]

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class CurveRows:
    """The step curves of one cell against one kind of work as a table: work, successes, and their share."""

    target: str
    attack: str
    along: str
    rows: list[tuple[float, int, float]]


@dataclass(frozen=True)
class Page:
    """The data of a campaign's page."""

    campaign: Campaign
    progress: Progress
    counts: Counts
    table: Table
    by_queries: list[Chart]
    by_seconds: list[Chart]
    by_p: list[Chart]
    corners: list[CurveRows]
    views: list[ChosenView]
    chosen: int
    why_none: str | None


@router.get("/campaigns")
def campaigns(
    services: ServicesDependency,
    caller: CallerDependency,
    state: CampaignState | None = None,
    cursor: Annotated[str | None, Query(max_length=200)] = None,
) -> Response:
    """The list of campaigns, newest first."""
    return _list("campaigns.html", services, caller, state, cursor)


@router.get("/parts/campaigns")
def campaigns_part(
    services: ServicesDependency,
    caller: CallerDependency,
    state: CampaignState | None = None,
    cursor: Annotated[str | None, Query(max_length=200)] = None,
) -> Response:
    """The part of the list that the script reloads."""
    return _list("_campaigns.html", services, caller, state, cursor)


@router.get("/campaigns/{campaign_id}")
def campaign(
    campaign_id: str,
    services: ServicesDependency,
    caller: CallerDependency,
    rows: Field = "scene",
    columns: Field = "attack",
    measure: Field = "success",
    row: Field | None = None,
    column: Field | None = None,
) -> Response:
    """The page of one campaign, with a heat map of two fields; `row` and `column` open a cell of it."""
    return _campaign("campaign.html", campaign_id, services, caller, Choice(rows, columns, measure, row, column))


@router.get("/parts/campaigns/{campaign_id}")
def campaign_part(campaign_id: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """The part of a campaign's page that the script reloads."""
    return _campaign("_campaign.html", campaign_id, services, caller)


@router.post("/campaigns/{campaign_id}/{move}")
def move(campaign_id: str, move: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Pauses, resumes or cancels a campaign, as the buttons on its page ask, and redirects to the page."""
    record = services.campaigns.record
    moves = {"pause": record.pause, "resume": record.resume, "cancel": record.cancel}
    if move not in moves or caller.visible(record.get(campaign_id)) is None:
        raise no_such("campaign")
    moves[move](campaign_id)
    return RedirectResponse(f"/campaigns/{campaign_id}", 303, HEADERS)


def _list(
    template: str, services: Services, caller: Caller, state: CampaignState | None, cursor: str | None
) -> Response:
    try:
        before = None if cursor is None else read_cursor(cursor)
    except InvalidRequest:
        before = None
    record = services.campaigns.record
    found = record.page(state, PAGE + 1, before, owner=caller.only)
    older = cursor_after(found[PAGE - 1]) if len(found) > PAGE else None
    progress = record.progress([one.id for one in found])
    lines = [(one, progress[one.id]) for one in found[:PAGE]]
    return html(template, caller=caller, lines=lines, state=state, cursor=cursor, older=older)


def _campaign(
    template: str, campaign_id: str, services: Services, caller: Caller, choice: Choice | None = None
) -> Response:
    found = caller.visible(services.campaigns.record.get(campaign_id, whole=True))
    if found is None:
        raise no_such("campaign")
    result = services.campaigns.result(found, curves=False)
    attacked = sorted(result.views, key=lambda view: not view.chosen)
    page = Page(
        campaign=found,
        progress=services.campaigns.progress(found),
        counts=services.campaigns.counts(found.id),
        table=result.table,
        by_queries=_charts(result.table, "queries"),
        by_seconds=_charts(result.table, "seconds"),
        by_p=_charts(result.table, "p"),
        corners=[_rows(cell, along) for along in ALONG for cell in result.table.cells if cell.success.of],
        views=attacked[:SHOWN],
        chosen=sum(view.chosen for view in result.views),
        why_none=nothing_chosen(result.views) if found.selected_at else None,
    )
    if choice is None:
        return html(template, caller=caller, page=page)
    return html(template, caller=caller, page=page, cases=cases(services.campaigns, found, choice))


def _charts(table: Table, along: Along) -> list[Chart]:
    """The step curves of the verified successes of each cell that has cases, all as far as any case went."""
    most = max((end(cell, along) for cell in table.cells), default=0.0) or 1.0
    return [_chart(cell, along, 1.05 * most) for cell in table.cells if cell.success.of]


def _chart(cell: Cell, along: Along, until: float) -> Chart:
    title = f"{cell.attack}, {cell.target}: verified successes, % of {cell.success.of}"
    return chart(title, ALONG[along], points(cell, along, until), low=0, high=100)


def _rows(cell: Cell, along: Along) -> CurveRows:
    return CurveRows(cell.target, cell.attack, ALONG[along], steps(corners(cell, along), cell.success.of))
