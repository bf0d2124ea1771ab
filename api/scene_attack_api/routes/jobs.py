"""Routes that preview, submit, list, read, follow, edit, cancel, continue and delete jobs."""

from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, HTTPException, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel

from scene_attack.client.schemas import JobEdit, JobPage, JobView, PreviewView
from scene_attack.runs.result import CHECKPOINT, PlannedCost
from scene_attack.runs.spec import JobSpec
from scene_attack_api.cursors import NEWEST, SORT_PATTERN, page_cursors, read_cursor
from scene_attack_api.requests import (
    SUBMISSION,
    CallerDependency,
    Client,
    DemandOfQuery,
    IdempotencyKey,
    KnownJob,
    PreferredWait,
    Services,
    ServicesDependency,
    body_of,
    json_body,
    no_such,
    while_connected,
)
from scene_attack_api.submissions import key_of
from scene_attack_api.views import job_summary, job_view
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.files import delete_with_files
from scene_attack_service.jobs.job_list import EXAMPLE, LONGEST_QUERY, Term, parse_query
from scene_attack_service.jobs.models import Job, State

QueryText = Annotated[
    str | None,
    Query(
        max_length=LONGEST_QUERY, description=f"which jobs to list, such as `{EXAMPLE}`; docs/service.md has the terms"
    ),
]
Sort = Annotated[
    str, Query(pattern=SORT_PATTERN, description='what to sort by; with "-" before it the greatest or newest first')
]
MOST_EVENTS = 2**31 - 1
"""Largest number of an event that a client may name."""

router = APIRouter(prefix="/v1", tags=["jobs"])


@router.post("/jobs", **SUBMISSION)
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
    return job_view(ended, with_result=True)


@router.get("/jobs", response_model=JobPage)
def list_jobs(
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
    about: dict[str, Any] = {"sort": sort, "after": place.after, "before": place.before, "owner": caller.only}
    shown = services.record.lists.page(terms, limit, **about)
    after, before = page_cursors(shown, sort)
    items = [job_summary(job) for job in shown.jobs]
    return _json(JobPage(items=items, next=after, previous=before))


@router.get("/jobs/{job_id}", response_model=JobView)
def get_job(job_id: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Returns one job, with its result once it succeeded."""
    job = caller.visible(services.record.jobs.get(job_id, with_result=True))
    if job is None:
        raise no_such("job")
    return _json(job_view(job, with_result=True))


def _json(answer: BaseModel) -> Response:
    """An answer that the framework does not validate again: a result may have a hundred thousand rows."""
    return Response(answer.model_dump_json(), media_type="application/json")


@router.patch("/jobs/{job_id}")
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
    return job_view(edited)


@router.post("/jobs/{job_id}/retry", status_code=202)
def retry_job(job: KnownJob, services: ServicesDependency, caller: CallerDependency, response: Response) -> JobView:
    """Queues the job's request again: a new job, whose `retry_of` is this one. A worker checks it before it runs."""
    queued = services.submissions.retry(caller, job.id)
    response.headers["Location"] = f"/v1/jobs/{queued.id}"
    return queued


@router.delete("/jobs/{job_id}", status_code=204)
def delete_job(job: KnownJob, services: ServicesDependency) -> None:
    """Deletes a job that has ended, with its files. Answers 409 while it has not, or if a campaign refers to it."""
    delete_with_files(services.record, services.store, job.id)


@router.post("/jobs/{job_id}/cancel", status_code=202)
def cancel_job(job: KnownJob, services: ServicesDependency) -> JobView:
    """Asks a job to stop: a queued job is cancelled at once, and a running job stops within a step.

    A job that has ended stays as it is. A repeated request has no further effect.
    """
    asked = services.storage.even_if_full(lambda: services.record.jobs.request_cancel(job.id))
    if asked is None:
        raise no_such("job")
    return job_view(asked)


@router.post("/jobs/{job_id}/continue", status_code=202)
def continue_job(job: KnownJob, services: ServicesDependency, caller: CallerDependency, response: Response) -> JobView:
    """Queues a new job that goes on where one stopped that was cancelled or failed, in time, queries and steps.

    It has the same request and begins with the earlier job's file `checkpoint.safetensors`; its `retry_of` is that job,
    which stays as it is. On a machine with another renderer or network backend the attack begins again, as its steps
    would differ in their last bits. Answers 409 if the job has not ended, has succeeded, or ended before its first
    checkpoint.
    """
    queued = continued(job, services, caller)
    response.headers["Location"] = f"/v1/jobs/{queued.id}"
    return queued


def continued(job: Job, services: Services, caller: Caller) -> JobView:
    """Queues the job that goes on from another's checkpoint. Raises HTTPException as above."""
    if job.state not in (State.CANCELLED, State.FAILED):
        raise HTTPException(409, f"the job is {job.state.value}; one that was cancelled or failed can be continued")
    checkpoint = services.record.jobs.artifact(job.id, CHECKPOINT)
    if checkpoint is None:
        raise HTTPException(409, "the job ended before its first checkpoint; send its request again")
    return services.submissions.retry(caller, job.id, checkpoint)


def resume_after(
    job: KnownJob,
    last_event_id: Annotated[
        int | None,
        Header(ge=0, le=MOST_EVENTS, description="number of the last event seen; the stream goes on after it"),
    ] = None,
) -> int:
    """The number of the event after which to resume. Answers 204 if no event will follow, so that browsers stop."""
    after = last_event_id or 0
    if job.state.terminal and after >= job.events:
        raise HTTPException(204)
    return after


@router.get(
    "/jobs/{job_id}/events",
    response_class=EventSourceResponse,
    responses={204: {"description": "no event will follow the last one seen; do not come back"}},
)
async def stream_job_events(
    job: KnownJob,
    services: ServicesDependency,
    caller: CallerDependency,
    after: Annotated[int, Depends(resume_after)],
) -> AsyncIterator[ServerSentEvent]:
    """Streams a job's events from the first, or from the one after `Last-Event-ID`, until the job has ended, or
    the caller's key.

    The data of a `state` event is {"state", "attempt"}, with "outcome" or "failure" at the end. The data of a
    `progress` event is {"phase", "step", "steps", "rows"}, where rows are those of the trace since the last event. A
    job that was interrupted repeats some of its steps.
    """
    async with aclosing(services.watcher.events(job, after, caller.key)) as events:
        async for event in events:
            yield ServerSentEvent(data=event.data, event=event.kind, id=str(event.number))


@router.post("/preview", dependencies=[Depends(json_body)])
async def preview_job(
    spec: Annotated[JobSpec, Depends(body_of(JobSpec))],
    services: ServicesDependency,
    caller: CallerDependency,
    client: Client,
    request: Request,
    plan: Annotated[
        bool, Query(description="whether to make the plan, too, which may take several times as long as the image")
    ] = False,
) -> PreviewView:
    """Shows what a job would begin with: the image, the network's first five answers, the warnings, and on demand the
    plan and its cost.

    Nothing is attacked and nothing is queued. A request that cannot run gets the same answer 422 as a job. One that
    takes longer than a preview may gets 413, and 503 says that other previews took all the time. A client that closes
    its connection gives up its turn.
    """
    shown, png = await while_connected(request, services.checks.preview(spec, caller, client))
    planned: PlannedCost | None = None
    if plan:
        planned = await while_connected(request, services.checks.plan(spec, client))
    return PreviewView(
        **dict(shown),
        png=png,
        plan=None if planned is None else planned.plan,
        cost=None if planned is None else planned.cost,
    )
