"""Counts of what the service has done since it was set up. They outlive processes, machines and deleted jobs.

A transaction collects what it counts, and adds it in one statement before it commits: counters are rows that all
processes change, so they are locked last, all in one order, and for a moment.
"""

from bisect import bisect_left
from collections import Counter

from sqlalchemy import event
from sqlalchemy.orm import Session

from services.jobs.models import Job, State, Total
from services.jobs.upsert import insert

STAGE_BOUNDS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
"""Upper bounds of the histogram of a stage's time, in seconds; above them is one more class."""


def count(session: Session, name: str, label: str = "", by: float = 1) -> None:
    """Adds `by` to a counter when the transaction ends."""
    if not by:
        return
    if "totals" not in session.info:
        session.info["totals"] = Counter()
        event.listen(session, "before_commit", _write, once=True)
    session.info["totals"][name, label] += by


def count_stage(session: Session, stage: str, seconds: float) -> None:
    """Adds the time of a stage to its histogram when the transaction ends."""
    bound = bisect_left(STAGE_BOUNDS, seconds)
    count(session, "stage", f"{stage} {STAGE_BOUNDS[bound] if bound < len(STAGE_BOUNDS) else '+Inf'}")
    count(session, "stage_seconds", stage, max(seconds, 0.0))


def count_end(session: Session, job: Job, seconds: float | None) -> None:
    """Counts a job that has ended; `seconds` is the time since its last phase began, None if it had not begun."""
    count(session, "ended", f"{job.kind.value} {job.state.value}")
    if job.state is State.FAILED:
        count(session, "failures", job.failure_kind or "")
    count(session, "steps", by=job.steps_done)
    count(session, "queries", by=job.queries_done)
    if job.phase is not None and seconds is not None:
        count_stage(session, job.phase, seconds)


def _write(session: Session) -> None:
    counted: Counter[tuple[str, str]] = session.info.pop("totals")
    rows = [{"name": name, "label": label, "value": by} for (name, label), by in sorted(counted.items())]
    added = insert(session, Total).values(rows)
    values = {"value": Total.value + added.excluded.value}
    session.execute(added.on_conflict_do_update(index_elements=[Total.name, Total.label], set_=values))
