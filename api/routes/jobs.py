"""Routes that submit, list, read and cancel jobs."""

import re
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, HTTPException, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from api.authentication import CallerDependency
from api.bodies import body_of
from api.demands import demand as demand_of
from api.job_edit import JobEdit
from api.job_places import SORT_PATTERN, read_cursor, write_cursor
from api.routes.connection import while_connected
from api.schemas import JobPage, JobSummary, JobView
from api.state import KnownJob, Services, ServicesDependency, no_such
from api.submissions import key_of
from services.jobs.job_query import EXAMPLE, LONGEST, Term, parse_query
from services.jobs.models import State
from services.jobs.placement import Demand, Priority
from services.pipeline.spec import JobSpec

LONGEST_WAIT = 30.0
"""Largest N of `Prefer: wait=N`, in seconds; larger values are reduced to it."""

QueryText = Annotated[
    str | None,
    Query(max_length=LONGEST, description=f"which jobs to list, such as `{EXAMPLE}`; docs/api.md has the fields"),
]
Sort = Annotated[
    str, Query(pattern=SORT_PATTERN, description='what to sort by; with "-" before it the greatest or newest first')
]
NEWEST = "-created"

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


def json_body(request: Request) -> None:
    """Answers 415 unless the content type is JSON, which a form of another web site cannot send."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json" and not re.fullmatch(r"application/[\w.-]+\+json", kind):
        raise HTTPException(415, "send the body as application/json")


def wait_preferred(prefer: Annotated[str | None, Header()] = None) -> float | None:
    """The seconds of `Prefer: wait=N` (RFC 7240), at most `LONGEST_WAIT`; None if the header has no such preference."""
    found = re.search(r"(?:^|,)\s*wait\s*=\s*\"?(\d{1,9})\"?\s*(?:;[^,]*)?(?:,|$)", prefer or "", re.IGNORECASE)
    return None if found is None else min(float(found[1]), LONGEST_WAIT)


SUBMISSION: dict[str, Any] = {
    "status_code": 202,
    "responses": {200: {"model": JobView, "description": "the job has ended within the time of `Prefer: wait`"}},
    "dependencies": [Depends(json_body)],
}
"""What routes have that submit a job."""
PreferredWait = Annotated[float | None, Depends(wait_preferred)]
DemandOfQuery = Annotated[Demand, Depends(demand_of(Priority.NORMAL))]
IdempotencyKey = Annotated[
    str | None,
    Header(min_length=1, max_length=255, description="a repeated key gets the first answer again, and no new job"),
]


@router.post("", **SUBMISSION)
async def submit_job(
    spec: Annotated[JobSpec, Depends(body_of(JobSpec))],
    services: ServicesDependency,
    caller: CallerDependency,
    request: Request,
    response: Response,
    demand: DemandOfQuery,
    wait: PreferredWait = None,
    idempotency_key: IdempotencyKey = None,
) -> JobView:
    """Queues one attack.

    The request's fields, names and limits are checked before the answer. So is whether the scene can be rendered and
    attacked, if that takes no longer than a few seconds. Otherwise `checked` is false and a worker checks it first: a
    request that cannot run ends as `rejected`, with the errors that the answer 422 would have had.

    With `Prefer: wait=N` the answer comes when the job has ended (200) or after N seconds, at most 30 (202). `warnings`
    says why a job that runs may show less than it seems to: the network is wrong before the attack, nobody knows the
    truth, or the network is unsure.
    """
    key = key_of(idempotency_key, spec, caller)
    job = await services.submissions.earlier(key)
    if job is None:
        checked = await while_connected(request, services.checks.check(spec, caller))
        job = await services.submissions.submit(spec, checked, caller, demand, key)
    return await answered(job, wait, services, response)


async def answered(job: JobView, wait: float | None, services: Services, response: Response) -> JobView:
    """The answer to a submission: the job, or what has become of it if it ends within `wait` seconds."""
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    if wait is None:
        return job
    response.headers["Preference-Applied"] = f"wait={wait:g}"
    ended = await services.watcher.ended_within(job.id, wait)
    if ended is None:
        return job
    response.status_code = 200
    return JobView.of(ended, with_result=True)


@router.get("", response_model=JobPage)
async def list_jobs(
    services: ServicesDependency,
    caller: CallerDependency,
    q: QueryText = None,
    sort: Sort = NEWEST,
    state: Annotated[list[State] | None, Query(description="repeated, it lists jobs in any of these states")] = None,
    kind: Annotated[
        Literal["attack", "rerendering"], Query(description="kind of the jobs to list; `q` may ask for both")
    ] = "attack",
    campaign: Annotated[
        str | None, Query(min_length=1, max_length=32, description="id of the campaign that queued the jobs")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(max_length=2000, description="`next` or `previous` of another page")] = None,
) -> Response:
    """Lists the jobs that meet a query, newest first or in another order."""
    terms = [*parse_query(q or "")]
    terms += [Term("kind", "=", (kind,))] if kind != "attack" else []
    terms += [Term("state", "=", tuple(state))] if state else []
    terms += [Term("campaign", "=", (campaign,))] if campaign is not None else []
    place = read_cursor(cursor, sort)

    def read() -> str:
        about: dict[str, Any] = {"sort": sort, "after": place.after, "before": place.before, "owner": caller.only}
        shown = services.record.lists.page(terms, limit, **about)
        after = write_cursor(sort, shown.last, backwards=False) if shown.last and shown.more_after else None
        before = write_cursor(sort, shown.first, backwards=True) if shown.first and shown.more_before else None
        items = [JobSummary.listed(job) for job in shown.jobs]
        return JobPage(items=items, next=after, previous=before).model_dump_json()

    # Others look at every job, or at every one of the owner.
    is_short = len(terms) == 0 and sort in ("created", NEWEST)
    return _json(await (services.reading(read) if is_short else run_in_threadpool(read)))


@router.get("/{job_id}", response_model=JobView)
async def get_job(job_id: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Returns one job, with its result once it succeeded."""

    def read() -> str | None:
        found = services.record.jobs.get(job_id, with_result=True)
        return None if found is None else JobView.of(found, with_result=True).model_dump_json()

    # No dependency reads the job before: clients ask for this more often than for anything else.
    job = caller.visible(await services.reading(services.record.jobs.get, job_id))
    if job is None:
        raise no_such("job")
    if job.state is not State.SUCCEEDED:
        return _json(JobView.of(job).model_dump_json())
    # A result may have a hundred thousand rows, which take seconds to check and to write.
    found = await run_in_threadpool(read)
    if found is None:  # it was deleted meanwhile
        raise no_such("job")
    return _json(found)


def _json(text: str) -> Response:
    """An answer that the framework does not validate again."""
    return Response(text, media_type="application/json")


@router.patch("/{job_id}")
def edit_job(
    job: KnownJob,
    _: Annotated[None, Depends(json_body)],
    changes: Annotated[JobEdit, Depends(body_of(JobEdit))],
    services: ServicesDependency,
) -> JobView:
    """Changes what people have said about a job: its title, tags and note. It changes no result."""
    services.record.lists.edit(job.id, changes.changes())
    edited = services.record.jobs.get(job.id)
    if edited is None:
        raise no_such("job")
    return JobView.of(edited)


@router.post("/{job_id}/retry", status_code=202)
def retry_job(job: KnownJob, services: ServicesDependency, caller: CallerDependency, response: Response) -> JobView:
    """Queues the job's request again: a new job, whose `retry_of` is this one. A worker checks it before it runs."""
    first = services.record.jobs.get(job.id)
    if first is None:
        raise no_such("job")
    queued = services.submissions.retry(caller, first)
    response.headers["Location"] = f"/v1/jobs/{queued.id}"
    return queued


@router.delete("/{job_id}", status_code=204)
def delete_job(job: KnownJob, services: ServicesDependency) -> None:
    """Deletes a job that has ended, with its files. Answers 409 while it has not, or if a campaign refers to it."""
    services.housekeeping.delete(job.id)


@router.post("/{job_id}/cancel", status_code=202)
def cancel_job(job: KnownJob, services: ServicesDependency) -> JobView:
    """Asks a job to stop: a queued job is cancelled at once, and a running job stops within a step.

    A job that has ended stays as it is. A repeated request has no further effect.
    """
    asked = services.storage.even_if_full(lambda: services.record.jobs.request_cancel(job.id))
    if asked is None:
        raise no_such("job")
    return JobView.of(asked)
