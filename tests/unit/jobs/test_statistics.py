"""The figures of the service and the record of each network, on both databases."""

from typing import Any

import pytest
from sqlalchemy import Engine

from scene_attack.runs.result import Result, outcome
from scene_attack.runs.spec import parse
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.models import State
from scene_attack_service.jobs.record import Record
from scene_attack_service.jobs.statistics import Figures, TargetRecords
from tests.unit.api.dashboard_records import SPEC as DASHBOARD_SPEC
from tests.unit.api.dashboard_records import result
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import OUTCOME, SPEC, add, start


@pytest.fixture
def figures(engine: Engine, clock: Clock) -> Figures:
    return Figures(Database(engine, clock))


def rows(*queries: int) -> list[dict[str, int]]:
    return [{"step": step, "queries": n} for step, n in enumerate(queries)]


def test_an_empty_record(figures: Figures) -> None:
    found = figures.read()
    assert (found.jobs, found.queued, found.oldest_seconds, found.stages) == ({}, 0, 0.0, {})


def test_the_queue_and_the_states(record: Record, figures: Figures, clock: Clock) -> None:
    first = add(record)
    clock.advance(5)
    add(record)
    clock.advance(2)
    found = figures.read()
    assert (found.queued, found.oldest_seconds) == (2, 7.0)
    start(record, first)
    found = figures.read()
    assert (found.queued, found.oldest_seconds) == (1, 2.0)
    assert found.jobs == {("attack", "queued"): 1, ("attack", "running"): 1}
    assert found.totals["submitted"] == {"attack": 2}


def test_steps_and_queries_never_fall_and_repeated_ones_count_once(
    record: Record, figures: Figures, engine: Engine
) -> None:
    job = add(record)
    attempt = start(record, job)
    record.leases.progress(attempt, "attacking", 2, 9, rows(2, 3, 4))
    assert figures.read().totals["steps"] == {"": 2}
    record.leases.lose(attempt)
    attempt = start(record, job)
    record.leases.progress(attempt, "attacking", 1, 9, rows(2, 3))
    assert figures.read().totals["queries"] == {"": 4}
    record.leases.succeed(attempt, {}, OUTCOME | {"steps": 5, "queries": 12}, [])
    with engine.execution_options(writes=True).begin() as connection:
        connection.exec_driver_sql("DELETE FROM jobs")
    found = figures.read()
    assert found.jobs == {}
    assert (found.totals["steps"], found.totals["queries"]) == ({"": 5}, {"": 12})
    assert found.totals["ended"] == {"attack succeeded": 1}


def test_failures_by_kind(record: Record, figures: Figures) -> None:
    for kind in ("timeout", "internal", "timeout"):
        record.leases.fail(start(record, add(record)), kind, "")
    record.jobs.request_cancel(add(record).id)
    totals = figures.read().totals
    assert totals["failures"] == {"internal": 1, "timeout": 2}
    assert totals["ended"] == {f"attack {State.CANCELLED.value}": 1, f"attack {State.FAILED.value}": 3}


def test_the_time_of_each_stage(record: Record, figures: Figures, clock: Clock) -> None:
    job = add(record)
    clock.advance(20)
    attempt = start(record, job)
    for phase, seconds in (("loading", 2.0), ("attacking", 4.0), ("attacking", 5.0), ("analysing", 0.05)):
        record.leases.progress(attempt, phase, 0, 9, [])
        clock.advance(seconds)
    record.leases.succeed(attempt, {}, {}, [])
    stages = figures.read().stages
    assert {stage: times.seconds for stage, times in stages.items()} == pytest.approx(
        {"waiting": 20, "loading": 2, "attacking": 9, "analysing": 0.05}
    )
    below = dict.fromkeys(("0.1", "0.3", "1.0", "3.0"), 0.0)
    above = dict.fromkeys(("10.0", "30.0", "100.0", "300.0", "1000.0", "3000.0", "+Inf"), 1.0)
    assert dict(stages["attacking"].up_to) == below | above


def test_the_wait_between_two_attempts_is_no_time_of_a_phase(record: Record, figures: Figures, clock: Clock) -> None:
    job = add(record)
    clock.advance(1)
    attempt = start(record, job)
    record.leases.progress(attempt, "attacking", 0, 9, [])
    clock.advance(2)
    record.leases.give_back(attempt)
    clock.advance(1000)
    record.jobs.request_cancel(job.id)
    assert {stage: times.seconds for stage, times in figures.read().stages.items()} == {"waiting": 1}


def test_nothing_is_counted_of_a_transaction_that_is_undone(record: Record, figures: Figures) -> None:
    add(record)
    with pytest.raises(KeyError):
        record.jobs.create(SPEC, 9, None, lambda _: {}["none"])
    assert figures.read().totals["submitted"] == {"attack": 1}


def submit(record: Record, target: str = "efficientnet-lite0", owner: str = "") -> str:
    spec = parse(DASHBOARD_SPEC.model_dump() | {"target": {"name": target}})
    job, _ = record.jobs.create(spec, 99, None, lambda _: {}, owner=owner)
    assert job is not None
    return job.id


def end(record: Record, job_id: str, weights: str = "aa" * 32, **changed: Any) -> None:
    """The job runs to its end, with a result of these fields."""
    attempt = record.leases.lease(job_id, "test", 60)
    assert attempt is not None
    found = result(**changed)
    found["provenance"]["weights_sha256"] = weights
    record.leases.succeed(attempt, found, outcome(Result.model_validate(found)), [])


def test_a_rate_is_of_the_scenes_that_the_network_had_right(record: Record, engine: Engine) -> None:
    end(record, submit(record))
    end(record, submit(record), outcome="held", verified=False)
    end(record, submit(record), verified=False)  # fooled in the loop only
    end(record, submit(record), outcome="still-wrong", right_before=False)
    end(record, submit(record), outcome="changed", right_before=None)
    end(record, submit(record, owner="other"))
    submit(record)
    found = TargetRecords(Database(engine)).all("")["efficientnet-lite0"]
    assert (found.jobs, found.open, found.right_before, found.successes) == (6, 1, 3, 1)
    assert found.rate.rate == 1 / 3
    assert TargetRecords(Database(engine)).all(None)["efficientnet-lite0"].successes == 2


def test_the_weights_are_those_of_the_newest_job(record: Record, engine: Engine, clock: Any) -> None:
    for weights in ("aa" * 32, "bb" * 32):
        end(record, submit(record), weights)
        clock.advance(1)
    submit(record, "resnet34")
    found = TargetRecords(Database(engine)).all(None)
    assert found["efficientnet-lite0"].weights_sha256 == "bb" * 32
    assert (found["resnet34"].weights_sha256, found["resnet34"].jobs) == (None, 1)
