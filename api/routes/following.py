"""Follows a job in the record while a worker runs it."""

import asyncio
import time
from collections.abc import AsyncIterator

from starlette.concurrency import run_in_threadpool

from services.jobs.models import Event, Job
from services.jobs.repository import Repository

POLL_SECONDS = 0.2
"""Time between two reads of the record."""


async def until_over(repository: Repository, job_id: str, seconds: float) -> Job | None:
    """Waits until the job has ended and returns it with its result; returns None if it takes more than `seconds`."""
    deadline = time.monotonic() + seconds
    while True:
        job = await run_in_threadpool(repository.get, job_id)
        if job is None or job.state.terminal:
            return await run_in_threadpool(lambda: repository.get(job_id, with_result=True))
        if time.monotonic() >= deadline:
            return None
        await asyncio.sleep(POLL_SECONDS)


async def events(repository: Repository, job_id: str, after: int) -> AsyncIterator[Event]:
    """Yields the job's events with a number above `after` as they are recorded, until the job has ended."""
    while True:
        for event in await run_in_threadpool(repository.events, job_id, after):
            yield event
            after = event.number
        job = await run_in_threadpool(repository.get, job_id)
        if job is None or (job.state.terminal and after >= job.events):
            return
        if after >= job.events:
            await asyncio.sleep(POLL_SECONDS)
