"""What a job without a result shows: its events, and the trace that they make."""

from collections.abc import Iterable, Iterator
from typing import Any

from services.jobs.models import Event
from services.jobs.repository import Repository


def all_events(repository: Repository, job_id: str) -> Iterator[Event]:
    """Every event of a job, in order."""
    after = 0
    while page := repository.events(job_id, after):
        yield from page
        after = page[-1].number


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
