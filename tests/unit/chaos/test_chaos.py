from collections import Counter

from benchmarks.chaos.counts import differences, without_times
from benchmarks.chaos.load import OTHERS, RUNNING, plan
from benchmarks.chaos.service import BACKEND, DATABASE, POSTMASTER


def test_a_plan_hits_everything_and_depends_on_its_seed_alone() -> None:
    found = plan(12, 7, seed=3, of_database=(POSTMASTER, BACKEND))
    assert Counter(kind for kind, _ in found) == {"kill": 12, "stop": 7}
    assert {target for kind, target in found if kind == "kill"} == {*RUNNING, POSTMASTER, BACKEND, *OTHERS}
    assert {target for kind, target in found if kind == "stop"} == {*RUNNING, DATABASE, *OTHERS}
    assert found == plan(12, 7, seed=3, of_database=(POSTMASTER, BACKEND))
    assert found != plan(12, 7, seed=4, of_database=(POSTMASTER, BACKEND))


def test_differences_are_named() -> None:
    assert differences({"a": [1, {"b": 2}]}, {"a": [1, {"b": 2}]}) == []
    assert differences({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}], "c": 4}) == [".a.1.b: 2 not 3", ".c: None not 4"]


def test_records_are_compared_without_their_seconds() -> None:
    record = {"steps": 3, "seconds": 1.5, "trace": [{"step": 0, "seconds": 0.1}]}
    assert without_times(record) == {"steps": 3, "trace": [{"step": 0}]}
