"""Jobs that were accepted before their check had ended, which a worker then settles or rejects."""

from scene_attack.errors import InvalidRequest
from scene_attack.runs.result import JobWarning
from scene_attack_service.jobs.models import State
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.records import SPEC, add, row, start


def test_a_job_accepted_before_its_check_is_settled_by_its_worker(record: Record) -> None:
    job = add(record, checked=False)
    before = record.jobs.get(job.id)
    assert before is not None
    assert not before.checked
    attempt = start(record, job)
    warning = JobWarning(code="low-confidence", field="scene", text="it is unsure")
    filled = SPEC.model_dump(mode="json") | {"goal": {"leave": "balloon"}, "target": {"name": "filled in"}}
    record.leases.checked(attempt, filled, "ab" * 32, [warning])
    found = row(record, job)
    assert (found["checked"], found["digest"], found["spec"]["goal"]) == (True, "ab" * 32, {"leave": "balloon"})
    assert (found["target"], found["name"]) == ("filled in", "sphere")
    assert found["warnings"] == [warning.model_dump(mode="json")]
    assert found["state"] is State.RUNNING


def test_a_rejected_job_has_ended_and_says_which_fields_are_bad(record: Record) -> None:
    job = add(record, checked=False)
    attempt = start(record, job)
    assert record.leases.reject(attempt, InvalidRequest("goal.leave", "there is no such label"))
    found = row(record, job)
    errors = [{"field": "goal.leave", "detail": "there is no such label"}]
    assert (found["state"], found["errors"], found["lease_owner"]) == (State.REJECTED, errors, None)
    assert found["events"][-1][2] == {"state": "rejected", "attempt": 1, "errors": errors}
    assert State.REJECTED.terminal
    assert record.leases.lease(job.id, "w", 20) is None


def test_an_attempt_that_was_taken_back_settles_and_rejects_nothing(record: Record) -> None:
    job = add(record, checked=False)
    late = start(record, job)
    record.leases.give_back(late)
    before = row(record, job)
    record.leases.checked(late, SPEC.model_dump(mode="json"), "ab" * 32, [])
    assert not record.leases.reject(late, InvalidRequest("goal", "it is bad"))
    assert row(record, job) == before
