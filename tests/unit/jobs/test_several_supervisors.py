"""What processes of several machines do to the record at once. SQLite has one writer at a time, PostgreSQL many."""

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import Engine, text
from sqlalchemy.orm import Session

from scene_attack_service.jobs import database as database_module
from scene_attack_service.jobs import leases
from scene_attack_service.jobs.campaigns import CHUNK, Feeder
from scene_attack_service.jobs.models import Job, State
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.campaign_stage import Stage, spec
from tests.unit.jobs.records import add, attacks, start

pytestmark = pytest.mark.slow

POSTGRESQL = pytest.mark.parametrize("database", ["postgresql"], indirect=True)


def waits_for_a_lock(engine: Engine) -> bool:
    """Whether a session of the database waits for another one."""
    with engine.connect() as connection:
        waiting = text(
            "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND wait_event_type = 'Lock'"
        )
        return bool(connection.scalar(waiting))


@POSTGRESQL
def test_a_cancel_that_comes_while_a_job_is_queued_again_is_not_lost(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = Record(engine)
    job = add(record)
    attempt = start(record, job)
    cancelling = threading.Thread(target=record.jobs.request_cancel, args=(job.id,))
    change_state = leases.change_state

    def cancel_meanwhile(session: Session, job_id: str, to: State, *rest: Any, **values: Any) -> Job | None:
        if to is State.QUEUED:
            cancelling.start()
            while cancelling.is_alive() and not waits_for_a_lock(engine):
                pass
        return change_state(session, job_id, to, *rest, **values)

    monkeypatch.setattr(leases, "change_state", cancel_meanwhile)
    record.leases.give_back(attempt)
    cancelling.join()
    found = record.jobs.get(job.id)
    assert found is not None
    assert found.state is State.CANCELLED


def test_supervisors_that_take_back_at_once_count_a_death_once(record: Record, clock: Any) -> None:
    jobs = [add(record) for _ in range(6)]
    for job in jobs:
        start(record, job)
    clock.advance(21)
    with ThreadPoolExecutor(4) as pool:
        taken = [job_id for some in pool.map(lambda _: record.leases.take_back(), range(4)) for job_id in some]
    assert sorted(taken) == sorted(job.id for job in jobs)
    assert {job.lost for job in attacks(record)} == {1}


def test_supervisors_that_feed_at_once_queue_each_view_once(engine: Engine, record: Record) -> None:
    stage = Stage(engine, record)
    stage.begin(spec(6 * CHUNK))
    feeders = [Feeder(record.database, 1000) for _ in range(4)]
    together = threading.Barrier(4)

    def tick(feeder: Feeder) -> None:
        together.wait()
        feeder.tick()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(tick, feeders))
    views = [view["number"] for job in stage.queued() for view in job.spec["views"]]
    assert sorted(views) == list(range(6 * CHUNK))


@POSTGRESQL
def test_a_lease_is_by_the_databases_clock(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    class Fast(datetime):
        """The clock of a machine that is an hour ahead."""

        @classmethod
        def now(cls, tz: Any = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz) + timedelta(hours=1)

    here = Record(engine)
    job = add(here)
    start(here, job, seconds=60)
    monkeypatch.setattr(database_module, "datetime", Fast)
    assert Record(engine).leases.take_back() == []
    monkeypatch.undo()
    found = here.jobs.get(job.id)
    assert found is not None
    assert abs(found.times["running"] - datetime.now(UTC)) < timedelta(minutes=5)
