"""The route for a job's events, as server-sent events."""

from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Annotated

from fastapi import APIRouter, Depends, Header, HTTPException
from fastapi.sse import EventSourceResponse, ServerSentEvent

from api.authentication import CallerDependency
from api.state import KnownJob, ServicesDependency

LARGEST = 2**31 - 1
"""Largest number of an event that a client may name."""

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


def resume_after(
    job: KnownJob,
    last_event_id: Annotated[
        int | None, Header(ge=0, le=LARGEST, description="number of the last event seen; the stream goes on after it")
    ] = None,
) -> int:
    """The number of the event after which to resume. Answers 204 if no event will follow, so that browsers stop."""
    after = last_event_id or 0
    if job.state.terminal and after >= job.events:
        raise HTTPException(204)
    return after


@router.get(
    "/{job_id}/events",
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
