"""What processes of several machines do to the record at once. SQLite has one writer at a time, PostgreSQL many."""

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import Engine, text
from sqlalchemy.orm import Session

from services.jobs import transactions
from services.jobs.campaigns import CHUNK, Feeder
from services.jobs.models import Job, State
from services.jobs.repository import Repository
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


class CancelledMeanwhile(Repository):
    """A record in which a client cancels a job at the moment at which it is queued again."""

    def _move(self, session: Session, job_id: str, to: State, *rest: Any, **values: Any) -> Job | None:
        if to is State.QUEUED:
            other = Repository(self._reads)
            self.cancelling = threading.Thread(target=other.request_cancel, args=(job_id,))
            self.cancelling.start()
            while self.cancelling.is_alive() and not waits_for_a_lock(self._reads):
                pass
        return super()._move(session, job_id, to, *rest, **values)


@POSTGRESQL
def test_a_cancel_that_comes_while_a_job_is_queued_again_is_not_lost(engine: Engine) -> None:
    repository = CancelledMeanwhile(engine)
    job = add(repository)
    repository.give_back(start(repository, job))
    repository.cancelling.join()
    found = repository.get(job.id)
    assert found is not None
    assert found.state is State.CANCELLED


def test_supervisors_that_take_back_at_once_count_a_death_once(repository: Repository, clock: Any) -> None:
    jobs = [add(repository) for _ in range(6)]
    for job in jobs:
        start(repository, job)
    clock.advance(21)
    with ThreadPoolExecutor(4) as pool:
        taken = [job_id for some in pool.map(lambda _: repository.take_back(3), range(4)) for job_id in some]
    assert sorted(taken) == sorted(job.id for job in jobs)
    assert {job.lost for job in attacks(repository)} == {1}


def test_supervisors_that_feed_at_once_queue_each_view_once(engine: Engine, repository: Repository) -> None:
    stage = Stage(engine, repository)
    stage.begin(spec(6 * CHUNK))
    feeders = [Feeder(engine, 1000) for _ in range(4)]
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

    here = Repository(engine)
    job = add(here)
    start(here, job, seconds=60)
    monkeypatch.setattr(transactions, "datetime", Fast)
    assert Repository(engine).take_back(3) == []
    monkeypatch.undo()
    found = here.get(job.id)
    assert found is not None
    assert abs(found.times["running"] - datetime.now(UTC)) < timedelta(minutes=5)
