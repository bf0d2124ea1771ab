"""The page that compares jobs, or campaigns: their results, what differs in their requests, images and curves."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response

from scene_attack.analysis.campaign_table import Cell, Table
from scene_attack.errors import InvalidRequest
from scene_attack_api.dashboard.campaigns import ALONG, Along, corners, end, points, steps
from scene_attack_api.dashboard.charts import Chart, overlay
from scene_attack_api.dashboard.pages import html
from scene_attack_api.dashboard.views import all_events, trace_of
from scene_attack_api.requests import CallerDependency, Services, ServicesDependency, no_such
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.models import CampaignState, Job, State

LETTERS = "ABCDEFGH"
"""Names of what is compared, at most so many: more colours cannot be told apart."""
CURVES: dict[str, tuple[str, tuple[float, ...]]] = {
    "loss": ("Probability to lower", (0, 1)),
    "advantage": ("Log-probability advantage", (0,)),
    "perceptibility": ("Perceptibility p", (0,)),
    "distance": ("Distance ‖ΔY‖₂", (0,)),
}
"""The title of each curve, and values that its axis has."""
Against = Literal["step", "queries", "seconds"]
ROWS = 40
"""Rows of the table behind the curves at most; the trace in the result has every one."""
ABSENT = "–"
"""Text of the table for a job whose request has no such field, or null there."""

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class Compared:
    """A job or a campaign of the comparison, and where its page is."""

    letter: str
    name: str
    address: str
    state: State | CampaignState
    spec: Mapping[str, Any]


@dataclass(frozen=True)
class ComparedJob(Compared):
    """A job of the comparison."""

    job: Job
    outcome: dict[str, Any] | None
    trace: Sequence[Mapping[str, Any]]
    """The rows of the result's trace, or those so far."""
    images: Collection[str]
    """Names of the images that there are."""


@dataclass(frozen=True)
class ComparedCampaign(Compared):
    """A campaign of the comparison, and its table."""

    table: Table


@dataclass(frozen=True)
class CampaignRow:
    """One attack on one target in every campaign."""

    target: str
    attack: str
    cells: list[Cell | None]
    """For each campaign; None if it does not combine the two, or none of its cases has ended."""
    chart: Chart | None
    corners: list[list[tuple[float, int, float]]]
    """The curve of each campaign as a table: work, successes, and their share."""


@router.get("/compare")
def compare(
    services: ServicesDependency,
    caller: CallerDependency,
    jobs: Annotated[str, Query(max_length=1000, description="ids, separated by commas")] = "",
    job: Annotated[list[str], Query(max_length=200)] = [],  # noqa: B006 - the framework copies it
    against: Against = "queries",
) -> Response:
    """Compares two to eight jobs, named by `jobs` or, as a form sends ticked boxes, by several `job`."""
    ids = named(jobs, job, "jobs, as in /compare?jobs=a,b")
    compared = []
    for letter, job_id in zip(LETTERS, ids, strict=False):
        stored = caller.visible(services.record.jobs.get(job_id, with_result=True))
        if stored is None:
            raise no_such(f"job as {job_id}")
        compared.append(_compared_job(services, stored, letter))
    charts = [curve for name in CURVES if (curve := _curve(compared, name, against))]
    along = {"step": "steps", "queries": "queries", "seconds": "seconds"}
    return _page(caller, "jobs", compared, ids, along, against, charts, _table(compared, against))


@router.get("/compare/campaigns")
def compare_campaigns(
    services: ServicesDependency,
    caller: CallerDependency,
    campaigns: Annotated[str, Query(max_length=1000, description="ids, separated by commas")] = "",
    campaign: Annotated[list[str], Query(max_length=200)] = [],  # noqa: B006 - the framework copies it
    against: Along = "queries",
) -> Response:
    """Compares two to eight campaigns, named by `campaigns` or, as a form sends ticked boxes, by several `campaign`."""
    ids = named(campaigns, campaign, "campaigns, as in /compare/campaigns?campaigns=a,b")
    compared = []
    for letter, campaign_id in zip(LETTERS, ids, strict=False):
        stored = caller.visible(services.record.campaigns.get(campaign_id, whole=True))
        if stored is None:
            raise no_such(f"campaign as {campaign_id}")
        table = services.record.campaigns.result(stored, curves=False).table
        about = (stored.name, f"/campaigns/{stored.id}", stored.state, stored.spec)
        compared.append(ComparedCampaign(letter, *about, table))
    rows = _campaign_rows(compared, against)
    charts = [row.chart for row in rows if row.chart]
    return _page(caller, "campaigns", compared, ids, ALONG, against, charts, rows)


def _page(
    caller: Caller,
    what: Literal["jobs", "campaigns"],
    compared: Sequence[Compared],
    ids: Sequence[str],
    along: Mapping[Any, str],
    against: str,
    charts: Sequence[Chart],
    rows: Sequence[Any],
) -> Response:
    """The page; `along` are what the curves may be drawn against, `rows` those of the table behind them."""
    query = "/compare?jobs=" if what == "jobs" else "/compare/campaigns?campaigns="
    return html(
        "compare.html",
        caller=caller,
        what=what,
        compared=compared,
        address=query + ",".join(ids),
        along=along,
        against=against,
        differing=differences([item.spec for item in compared]),
        charts=charts,
        rows=rows,
    )


def _compared_job(services: Services, job: Job, letter: str) -> ComparedJob:
    trace = trace_of(job, all_events(services.record, job.id))
    images = {
        artifact.name for artifact in services.record.jobs.artifacts(job.id) if artifact.media_type == "image/png"
    }
    about = (job.title or job.name or "", f"/jobs/{job.id}", job.state, job.spec)
    return ComparedJob(letter, *about, job, job.outcome, trace, images)


def named(listed: str, ticked: Sequence[str], what: str) -> list[str]:
    """The ids in a list with commas and of ticked boxes. `what` is the field, and how it is written.

    Raises InvalidRequest, which names the field, unless they can be compared.
    """
    ids = [part.strip() for part in (*(listed.split(",") if listed.strip() else ()), *ticked)]
    field = what.partition(",")[0]
    if not all(ids):
        raise InvalidRequest(field, "one of the ids is empty")
    if not 2 <= len(ids) <= len(LETTERS):
        raise InvalidRequest(field, f"name 2 to {len(LETTERS)} {what}; {len(ids)} are named")
    return ids


def differences(specs: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """The dotted path of each field whose values differ, and the value of each request in words."""
    flat = [dict(_fields(spec)) for spec in specs]
    paths = list(dict.fromkeys(path for fields in flat for path in fields))
    return [
        (path, [_words(fields.get(path)) for fields in flat])
        for path in paths
        if any(path not in fields or fields[path] != flat[0].get(path) for fields in flat)
    ]


def _words(value: Any) -> str:
    """A value of a request, exactly, as two that differ must not look alike; "{}" is an object of defaults alone."""
    if value is None:
        return ABSENT
    return ", ".join(map(str, value)) or "none" if isinstance(value, list) else str(value)


def _fields(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if not parts or (isinstance(value, list) and not any(isinstance(item, dict | list) for item in value)):
        yield path, value
        return
    for name, part in parts:
        yield from _fields(part, f"{path}.{name}" if path else str(name))


def _curve(compared: Sequence[ComparedJob], name: str, against: str) -> Chart | None:
    title, include = CURVES[name]
    curves = [(item.letter, [(row[against], row[name]) for row in item.trace]) for item in compared]
    return overlay(title, against, curves, include)


def _table(compared: Sequence[ComparedJob], against: str) -> list[list[tuple[float, float, float] | None]]:
    """For each job (x, advantage, p) of some of its rows, first and last among them."""
    columns = []
    for item in compared:
        every = -(-len(item.trace) // ROWS) or 1
        kept = [row for number, row in enumerate(item.trace) if number % every == 0 or number == len(item.trace) - 1]
        columns.append([(row[against], row["advantage"], row["perceptibility"]) for row in kept])
    return [list(row) for row in zip_longest(*columns)]


def _campaign_rows(compared: Sequence[ComparedCampaign], against: Along) -> list[CampaignRow]:
    """A row for each target and attack of any campaign, in the order in which they first occur."""
    pairs = dict.fromkeys((cell.target, cell.attack) for item in compared for cell in item.table.cells)
    return [_campaign_row(compared, target, attack, against) for target, attack in pairs]


def _campaign_row(compared: Sequence[ComparedCampaign], target: str, attack: str, against: Along) -> CampaignRow:
    all_cells = [item.table.cell(target, attack) for item in compared]
    cells = [cell if cell and cell.success.of else None for cell in all_cells]
    until = 1.05 * max((end(cell, against) for cell in cells if cell), default=0.0) or 1.0
    curves = [
        (item.letter, points(cell, against, until) if cell else []) for item, cell in zip(compared, cells, strict=True)
    ]
    return CampaignRow(
        target=target,
        attack=attack,
        cells=cells,
        chart=overlay(f"{attack}, {target}: verified successes, % of all cases", ALONG[against], curves),
        corners=[steps(corners(cell, against), cell.success.of) if cell else [] for cell in cells],
    )
