"""The trace of a job, with and without a result: what its events make of it."""

from collections.abc import Iterable, Iterator
from typing import Any

from services.jobs.models import Event, Job
from services.jobs.repository import Repository


def all_events(repository: Repository, job_id: str) -> Iterator[Event]:
    """Every event of a job, in order."""
    after = 0
    while page := repository.events(job_id, after):
        yield from page
        after = page[-1].number


def trace_of(job: Job, events: Iterable[Event]) -> list[dict[str, Any]]:
    """The trace of the result or, if there is none yet, that of the events, which are read for this alone."""
    if job.result:
        found: list[dict[str, Any]] = job.result["trace"]
        return found
    return trace_of_events(events)


def trace_of_events(events: Iterable[Event]) -> list[dict[str, Any]]:
    """The trace so far. A resumed attempt repeats some steps; its rows replace the earlier rows of these steps."""
    rows: list[dict[str, Any]] = []
    for event in events:
        if event.kind != "progress":
            continue
        for row in event.data["rows"]:
            while rows and rows[-1]["step"] >= row["step"]:
                rows.pop()
            rows.append(row)
    return rows
