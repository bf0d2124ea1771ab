"""What another process commits between two statements of a transaction."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

import pytest
from sqlalchemy import Engine, event, select, text, update
from sqlalchemy.exc import OperationalError

from scene_attack_service.jobs.models import Campaign, CampaignState, Job
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.campaign_stage import Stage, spec
from tests.unit.jobs.records import OUTCOME, add, start
from tests.unit.jobs.test_several_supervisors import POSTGRESQL

pytestmark = pytest.mark.slow


@contextmanager
def meanwhile(engine: Engine, before: str, action: Callable[[], Any]) -> Iterator[list[str]]:
    """Takes the action once, before the next statement that has these words. Yields the statement once it was met."""
    met: list[str] = []

    def act(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        if not met and before in statement:
            met.append(statement)
            action()

    event.listen(engine, "before_cursor_execute", act)
    try:
        yield met
    finally:
        event.remove(engine, "before_cursor_execute", act)
    assert met, f"no statement has {before!r}"


@POSTGRESQL
def test_a_job_that_is_deleted_while_its_events_are_read_has_ended(engine: Engine, record: Record) -> None:
    job = add(record)
    assert record.leases.succeed(start(record, job), {}, OUTCOME, [])
    with meanwhile(engine, "FROM events", lambda: Record(engine).jobs.delete(job.id)):
        news = record.jobs.news({job.id: 1})
    assert news[job.id].events == []
    assert news[job.id].ended


@POSTGRESQL
def test_counters_do_not_fall_when_a_job_ends_while_they_are_read(engine: Engine, record: Record) -> None:
    job = add(record)
    attempt = start(record, job)
    record.leases.progress(attempt, "attacking", 3, 9, [{"step": 3, "queries": 7}])
    before = Record(engine).figures.read()

    def end() -> None:
        record.leases.succeed(attempt, {}, OUTCOME | {"steps": 3, "queries": 7}, [])

    with meanwhile(engine, "sum(jobs.steps_done)", end):
        during = Record(engine).figures.read()
    after = Record(engine).figures.read()
    assert before.totals["steps"][""] <= during.totals["steps"][""] <= after.totals["steps"][""]
    assert sum(during.jobs.values()) == 1


def test_a_campaign_that_is_cancelled_meanwhile_does_not_fail(engine: Engine, record: Record) -> None:
    stage = Stage(engine, record)
    campaign = stage.begin(spec())
    with engine.execution_options(writes=True).begin() as connection:
        connection.execute(update(Campaign).values(spec={"name": "of another version"}))
    with meanwhile(engine, "SELECT campaigns.spec", lambda: stage.campaigns.cancel(campaign)):
        stage.feeder.tick()
    assert stage.campaign(campaign).state is CampaignState.CANCELLED


def test_a_campaign_that_is_cancelled_meanwhile_is_not_planned(engine: Engine, record: Record) -> None:
    stage = Stage(engine, record)
    campaign = stage.begin(spec())
    stage.feeder.tick()
    for job in stage.queued():
        stage.work(job)
    with meanwhile(engine, "jobs.kind = ", lambda: stage.campaigns.cancel(campaign)):
        stage.feeder.tick()
    assert stage.campaign(campaign).state is CampaignState.CANCELLED
    assert stage.campaigns.jobs(campaign, 9, -1) == []


@pytest.mark.parametrize("end", ["progress", "succeed", "request_cancel"])
def test_the_time_of_an_event_is_that_of_its_turn_to_write(engine: Engine, record: Record, end: str) -> None:
    """Read before a write has its lock, it would be earlier than that of the event before."""
    job = add(record)
    attempt = start(record, job)
    locked: list[bool] = []

    def clock() -> datetime:
        kind = engine.dialect.name
        with engine.connect() as other:
            try:
                if kind == "postgresql":
                    other.execute(select(Job.id).where(Job.id == job.id).with_for_update(nowait=True))
                else:
                    other.execute(text("PRAGMA busy_timeout=0"))
                    other.execute(text("ROLLBACK"))
                    other.execute(text("BEGIN IMMEDIATE"))
            except OperationalError:
                locked.append(True)
            else:
                locked.append(False)
            if kind == "sqlite":
                other.invalidate()
        return datetime.now(UTC)

    late = Record(engine, clock)
    {
        "progress": lambda: late.leases.progress(attempt, "attacking", 1, 9, []),
        "succeed": lambda: late.leases.succeed(attempt, {}, OUTCOME, []),
        "request_cancel": lambda: late.jobs.request_cancel(job.id),
    }[end]()
    assert locked
    assert all(locked)
