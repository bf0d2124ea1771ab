from collections import Counter
from datetime import UTC, datetime
from typing import Any

from benchmarks.chaos.counts import Gap, differences, gaps, recovery, without_times
from benchmarks.chaos.faults import OTHERS, RUNNING, Fault, plan
from benchmarks.chaos.service import BACKEND, DATABASE, POSTMASTER
from services.jobs.models import Event


def event(at: float, kind: str, **data: Any) -> Event:
    return Event(job_id="j", number=0, kind=kind, data=data, created_at=datetime.fromtimestamp(at, UTC))


def test_a_plan_hits_everything_and_depends_on_its_seed_alone() -> None:
    found = plan(12, 7, seed=3, of_database=(POSTMASTER, BACKEND))
    assert Counter(kind for kind, _ in found) == {"kill": 12, "stop": 7}
    assert {target for kind, target in found if kind == "kill"} == {*RUNNING, POSTMASTER, BACKEND, *OTHERS}
    assert {target for kind, target in found if kind == "stop"} == {*RUNNING, DATABASE, *OTHERS}
    assert found == plan(12, 7, seed=3, of_database=(POSTMASTER, BACKEND))
    assert found != plan(12, 7, seed=4, of_database=(POSTMASTER, BACKEND))


def steps(*numbers: int) -> list[dict[str, int]]:
    return [{"step": number} for number in numbers]


def test_a_gap_lasts_from_the_last_step_of_an_attempt_to_the_first_of_the_next() -> None:
    events = [
        event(0, "state", state="queued"),
        event(1, "state", state="running"),
        event(2, "progress", phase="loading"),
        event(3, "progress", phase="attacking", rows=steps(0)),
        event(4, "progress", phase="attacking", rows=steps(1, 2, 3)),
        event(9, "state", state="queued"),
        event(10, "state", state="running"),
        event(11, "progress", phase="loading"),
        event(12, "progress", phase="attacking", rows=steps(2, 3)),
        event(13, "progress", phase="analysing", step=5),
        event(14, "state", state="queued"),
        event(15, "progress", phase="attacking", rows=steps(0)),
    ]
    assert gaps(events) == [Gap(4, 12, 1, 3, 2), Gap(13, 15, 1, 5, 0)]
    assert gaps(events[:5]) == []


def test_recovery_is_counted_from_the_fault_and_only_where_it_was_the_only_one() -> None:
    alone, again, twice = Gap(4, 12, 3, 8, 5), Gap(40, 43, 2, 6, 0), Gap(20, 50, 2, 3, 0)
    job, worker = "worker.job_process", "worker.rq_worker"
    faults = [Fault("kill", job, 5.0), Fault("stop", "api.main", 6.0), Fault("kill", job, 21.0)]
    faults += [Fault("stop", worker, 30.0), Fault("kill", job, 41.0)]
    assert recovery([alone, again, twice], faults) == {
        f"kill {job}": {
            "gaps": 2,
            "median s": 4.5,
            "longest s": 7.0,
            "from a checkpoint": 1,
            "most steps repeated": 7,
            "longest s of steps before one began again": 2,
        }
    }


def test_differences_are_named() -> None:
    assert differences({"a": [1, {"b": 2}]}, {"a": [1, {"b": 2}]}) == []
    assert differences({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}], "c": 4}) == [".a.1.b: 2 not 3", ".c: None not 4"]


def test_records_are_compared_without_their_seconds() -> None:
    record = {"steps": 3, "seconds": 1.5, "trace": [{"step": 0, "seconds": 0.1}]}
    assert without_times(record) == {"steps": 3, "trace": [{"step": 0}]}
