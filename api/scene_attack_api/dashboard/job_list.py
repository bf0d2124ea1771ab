"""The page of the jobs: one query box that is the address, sortable columns, and what is done with the ticked jobs."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.responses import RedirectResponse

from scene_attack.client.schemas import MOST_TAGS, TAG_WORDS, is_tag
from scene_attack.errors import InUse, InvalidRequest, QuotaExceeded
from scene_attack_api.cursors import NEWEST, SORT_PATTERN, page_cursors, read_cursor
from scene_attack_api.dashboard.pages import HEADERS, html, part_of
from scene_attack_api.requests import CallerDependency, Services, ServicesDependency
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.files import delete_with_files
from scene_attack_service.jobs.job_list import EXAMPLE, LONGEST_QUERY, ListedJob, ListTotals, parse_query
from scene_attack_service.jobs.jobs import QueueFull
from scene_attack_service.jobs.models import State

PAGE = 50
"""Number of jobs on one page of the list."""
MOST = 200
"""Jobs that one request acts upon at most."""

router = APIRouter(include_in_schema=False)
Text = Annotated[str, Query(max_length=LONGEST_QUERY)]
Sort = Annotated[str, Query(pattern=SORT_PATTERN)]
Place = Annotated[str | None, Query(max_length=2000)]


@dataclass(frozen=True)
class Column:
    """A column of the table: its name in sorts and styles, its heading, and how it begins."""

    name: str
    title: str
    first: str = ""
    """The sort of a first click; "" for a column by which nothing is sorted."""
    number: bool = False
    shown: bool = True
    """Whether it is shown to a reader who has not chosen columns."""


COLUMNS = (
    Column("images", "Images"),
    Column("name", "Scene and attack", "name"),
    Column("state", "State", "state"),
    Column("answer", "The network said"),
    Column("outcome", "Outcome", "-verified"),
    Column("p", "p ×10⁻³", "p", number=True),
    Column("queries", "Queries", "queries", number=True),
    Column("seconds", "Run time", "seconds", number=True),
    Column("created", "Posted", "-created"),
    Column("ended", "Ended", "-ended", shown=False),
    Column("renderer", "Renderer", "renderer", shown=False),
    Column("method", "Method", "method", shown=False),
    Column("target", "Target", "target", shown=False),
)


@dataclass(frozen=True)
class Strip:
    """Summary of all jobs of a caller, above the list."""

    totals: ListTotals
    seconds_left: float | None
    """Time until all jobs have ended, at the mean run time; None if all have, or if no run time is known."""

    @classmethod
    def of(cls, totals: ListTotals) -> "Strip":
        """The strip of the sums over all jobs of a caller."""
        running = totals.states.get(State.RUNNING, 0) + totals.states.get(State.CANCELLING, 0)
        left = running + totals.states.get(State.QUEUED, 0)
        known = bool(left and totals.decided)
        return cls(totals, totals.seconds / totals.decided * left / max(running, 1) if known else None)


@router.get("/")
@router.get("/parts/jobs")
def jobs(
    request: Request,
    services: ServicesDependency,
    caller: CallerDependency,
    q: Text = "",
    sort: Sort = NEWEST,
    cursor: Place = None,
) -> Response:
    """The list of jobs that meet a query."""
    return shown(part_of(request, "jobs.html"), services, caller, q, sort, cursor)


@router.post("/jobs/selected")
def act(
    services: ServicesDependency,
    caller: CallerDependency,
    action: Annotated[Literal["cancel", "retry", "delete", "tag"], Form()],
    job: Annotated[list[str], Form(max_length=MOST)] = [],  # noqa: B006 - the framework copies it
    tag: Annotated[str, Form(max_length=50)] = "",
    q: Annotated[str, Form(max_length=LONGEST_QUERY)] = "",
    sort: Annotated[str, Form(pattern=SORT_PATTERN)] = NEWEST,
    cursor: Annotated[str, Form(max_length=2000)] = "",
) -> Response:
    """Does something with the ticked jobs and redirects to the list; where some refuse, it shows the list and why."""
    refused = [] if job else ["no job is ticked"]
    if action == "tag" and not is_tag(tag):
        refused.append(TAG_WORDS)
    for job_id in dict.fromkeys(job) if not refused else ():
        try:
            _act(services, caller, action, job_id, tag)
        except (InvalidRequest, InUse, QuotaExceeded) as error:
            refused.append(f"{job_id[:8]}: {error}")
        except QueueFull:
            refused.append(f"{job_id[:8]}: the queue is full")
    if refused:
        return shown("jobs.html", services, caller, q, sort, cursor or None, refused)
    return RedirectResponse(address(q, sort, cursor or None), 303, HEADERS)


def _act(services: Services, caller: Caller, action: str, job_id: str, tag: str) -> None:
    job = None if "\0" in job_id else caller.visible(services.record.jobs.get(job_id))
    if job is None:
        raise InUse("there is no such job")
    if action == "cancel":
        services.record.jobs.request_cancel(job_id)
    elif action == "delete":
        delete_with_files(services.record, services.store, job_id)
    elif action == "tag":
        tags = {*(job.tags or []), tag}
        if len(tags) > MOST_TAGS:
            raise InUse(f"it has {MOST_TAGS} tags already, and may have no more")
        services.record.lists.edit(job_id, {"tags": tags})
    else:
        services.submissions.retry(caller, job_id)


def address(q: str, sort: str, cursor: str | None = None) -> str:
    """The address of a list."""
    parameters = {"q": q, "sort": "" if sort == NEWEST else sort, "cursor": cursor or ""}
    chosen = urlencode({name: value for name, value in parameters.items() if value})
    return f"/?{chosen}" if chosen else "/"


def shown(
    template: str,
    services: Services,
    caller: Caller,
    q: str,
    sort: str,
    cursor: str | None,
    refused: list[str] | None = None,
) -> Response:
    """The list, or with status 422 an empty one that says where the query cannot be read."""
    about: dict[str, Any] = {"q": q, "sort": sort, "cursor": cursor, "caller": caller, "refused": refused or []}
    about |= {"columns": COLUMNS, "address": address, "example": EXAMPLE}
    strip = Strip.of(services.record.lists.totals((), caller.only))
    try:
        terms, place = parse_query(q), read_cursor(cursor, sort)
    except InvalidRequest as error:
        none: dict[str, Any] = {"lines": [], "totals": None, "older": None, "newer": None}
        return html(template, 422, strip=strip, error=error.detail, **none, **about)
    page = services.record.lists.page(terms, PAGE, sort=sort, after=place.after, before=place.before, owner=caller.only)
    older, newer = page_cursors(page, sort)
    lines: list[tuple[ListedJob, Any]] = [(job, job.outcome) for job in page.jobs]
    totals = services.record.lists.totals(terms, caller.only) if terms else strip.totals
    return html(template, strip=strip, error=None, lines=lines, totals=totals, older=older, newer=newer, **about)
