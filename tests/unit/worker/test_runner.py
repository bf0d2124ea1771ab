"""The runner with a real record and a real child, which renders nothing."""

import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy.exc import InternalError

from scene_attack.client.states import Priority
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.leases import Attempt, Standing
from scene_attack_service.jobs.models import Job, State
from scene_attack_service.jobs.processes import Child
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from scene_attack_worker import rq_worker
from scene_attack_worker.rq_worker import Runner
from tests.unit.jobs.records import add, start

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("children_of_tests")]


class Stage:
    """A record, and a runner for it; `pids` are those of its job processes."""

    def __init__(self, data: Path, **values: Any) -> None:
        self.data = data
        settings = Settings(data=data, lease_seconds=0.4, **values)  # a renewal each tenth of a second
        self.engine = connect(settings)
        migrate(self.engine, settings)
        self.record = Record(self.engine)
        self.runner = Runner(settings, self.record, "w")
        self.pids: list[int] = []

    def child(self, _module: str, settings: Settings) -> Child:
        made = Child("tests.unit.worker.scripted_child", settings)
        self.pids.append(made.pid)
        return made

    def script(self, does: str) -> None:
        """What the process does with its next job: answer, die, hang, or meet an outage."""
        (self.data / "script").write_text(does)

    def run(self, does: str, beat: Callable[[], Any] = lambda: None) -> Job:
        """Runs a new job, and returns what the record then has of it."""
        self.script(does)
        job = add(self.record)
        self.runner.run(Priority.NORMAL, beat)
        return self.found(job)

    def found(self, job: Job) -> Job:
        found = self.record.jobs.work(job.id)
        assert found is not None
        return found

    def ended(self, number: int) -> bool:
        """Whether the job process of this number has ended."""
        try:
            os.kill(self.pids[number], 0)
        except ProcessLookupError:
            return True
        return False


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Stage]]:
    made: list[Stage] = []

    def stage(**values: Any) -> Stage:
        made.append(Stage(tmp_path, **values))
        monkeypatch.setattr(rq_worker, "Child", made[-1].child)
        return made[-1]

    yield stage
    for one in made:
        one.runner.close()
        one.engine.dispose()


@pytest.fixture
def stage(make: Callable[..., Stage]) -> Stage:
    return make()


def test_a_job_is_left_to_its_process_and_the_process_stays(stage: Stage) -> None:
    assert [stage.run("answer").state for _ in range(2)] == [State.RUNNING, State.RUNNING]
    assert len(stage.pids) == 1
    assert stage.runner.abilities.memory == 7


def test_a_process_that_dies_loses_its_attempt(stage: Stage) -> None:
    job = stage.run("die")
    assert (job.state, job.lost, job.attempt) == (State.QUEUED, 1, 1)
    stage.runner.ensure_ready()
    assert len(stage.pids) == 2


def test_a_process_that_hangs_loses_its_attempt(make: Callable[..., Stage]) -> None:
    stage = make(stall_seconds=1.5)
    job = stage.run("hang")
    assert (job.state, job.lost) == (State.QUEUED, 1)
    assert stage.ended(0)


def test_a_job_that_takes_too_long_fails(make: Callable[..., Stage]) -> None:
    stage = make(job_seconds=0.3)
    job = stage.run("hang")
    assert (job.state, job.failure_kind) == (State.FAILED, "timeout")
    assert stage.ended(0)


def test_a_worker_that_stops_gives_its_job_back(stage: Stage) -> None:
    job = stage.run("hang", stage.runner.request_stop)
    assert (job.state, job.lost, job.lease_owner) == (State.QUEUED, 0, None)
    assert stage.ended(0)


def test_a_process_that_does_not_stop_when_its_job_is_cancelled_is_killed(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rq_worker, "STOP_SECONDS", 0.0)
    stage.script("hang")
    job = add(stage.record)
    stage.runner.run(Priority.NORMAL, lambda: stage.record.jobs.request_cancel(job.id))
    assert stage.found(job).state is State.CANCELLED
    assert stage.ended(0)


def test_a_process_whose_job_was_taken_back_is_killed_and_the_job_left_alone(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rq_worker, "STOP_SECONDS", 0.0)
    stage.script("hang")
    job = add(stage.record)
    others: list[Attempt] = []

    def take() -> None:
        if not others:
            stage.record.leases.take_back(owner="w")
            others.append(start(stage.record, job, "other"))

    stage.runner.run(Priority.NORMAL, take)
    assert (stage.found(job).state, stage.found(job).lease_owner) == (State.RUNNING, "other")
    assert stage.ended(0)


def test_the_lease_is_renewed(stage: Stage) -> None:
    stage.script("hang")
    job = add(stage.record)
    until = []

    def look() -> None:
        until.append(stage.found(job).lease_until)
        if len(until) == 3:
            stage.runner.request_stop()

    stage.runner.run(Priority.NORMAL, look)
    assert until == sorted(set(until))


@pytest.mark.parametrize(("usable", "lost"), [(True, 1), (False, 0)])
def test_an_outage_counts_only_if_it_cannot_be_seen(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, usable: bool, lost: int
) -> None:
    monkeypatch.setattr(Runner, "usable", lambda _: usable)
    job = stage.run("outage")
    assert (job.state, job.lost) == (State.QUEUED, lost)


def test_the_next_job_runs(stage: Stage) -> None:
    stage.script("answer")
    first, second = add(stage.record), add(stage.record)
    stage.runner.run(Priority.NORMAL, lambda: None)
    assert (stage.found(first).state, stage.found(second).state) == (State.RUNNING, State.QUEUED)


def test_a_process_is_replaced_after_so_many_jobs(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rq_worker, "MAX_JOBS", 2)
    for _ in range(3):
        stage.run("answer")
    assert len(stage.pids) == 2
    assert stage.ended(0)


def test_a_lease_that_cannot_be_renewed_is_no_end(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """A database that was made read-only says so by another class of errors than one that is away."""
    tries: list[Attempt] = []

    def renew(attempt: Attempt, _seconds: float) -> Standing:
        tries.append(attempt)
        if len(tries) == 2:
            stage.runner.request_stop()
        raise InternalError("UPDATE jobs", {}, Exception("cannot execute UPDATE in a read-only transaction"))

    monkeypatch.setattr(stage.record.leases, "renew", renew)
    assert stage.run("hang").state is State.QUEUED
    assert len(tries) == 2


def test_no_process_goes_on_with_a_job_that_nobody_watches(stage: Stage) -> None:
    """The next job would take its answer for its own."""

    def fail() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        stage.run("hang", fail)
    assert stage.ended(0)


def test_a_database_that_does_not_answer_is_left_to_the_record(make: Callable[..., Stage], tmp_path: Path) -> None:
    stage = make(stall_seconds=1.5)
    stage.script("hang")
    job = add(stage.record)
    with closing(sqlite3.connect(tmp_path / "jobs.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        stage.runner.run(Priority.NORMAL, lambda: None)
        assert stage.found(job).state is State.QUEUED  # the supervisor will ring again
        other.execute("ROLLBACK")
        stage.runner.run(
            Priority.NORMAL, lambda: other.execute("BEGIN IMMEDIATE") if not other.in_transaction else None
        )
        assert stage.found(job).state is State.RUNNING  # until its lease lapses
    assert stage.ended(0)
