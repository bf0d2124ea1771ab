import asyncio
from concurrent.futures import ThreadPoolExecutor
from math import nan
from pathlib import Path
from typing import Any, cast

import pytest
from sqlalchemy.exc import StatementError

from scene_attack.client.schemas import JobView
from scene_attack.errors import QuotaExceeded
from scene_attack_api.submissions import Submissions
from scene_attack_service.access.caller import KEYLESS, Quotas
from scene_attack_service.jobs.jobs import Key, KeyReused, QueueFull
from scene_attack_service.jobs.leases import MAX_ATTEMPTS, Attempt, Standing
from scene_attack_service.jobs.models import Job, State
from scene_attack_service.jobs.queue import NO_DEMAND, Queue, connect
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import OUTCOME, SPEC, add, artifact, attacks, row, start, state

pytestmark = pytest.mark.slow


def test_a_new_job_is_queued_with_its_whole_spec(record: Record, clock: Clock) -> None:
    job = record.jobs.get(add(record).id)
    assert job is not None
    assert (job.state, job.attempt, job.seed, job.events) == (State.QUEUED, 0, 7, 1)
    assert job.times == {"queued": clock.now}
    assert job.spec == SPEC.model_dump(mode="json")


def test_a_job_is_leased_once(record: Record) -> None:
    job = add(record)
    assert record.leases.lease(job.id, "a", 20) == Attempt(job.id, 1)
    assert record.leases.lease(job.id, "b", 20) is None


def test_a_new_attempt_has_come_nowhere_yet(record: Record) -> None:
    job = add(record)
    attempt = start(record, job)
    record.leases.progress(attempt, "attacking", 3, 9, [])
    record.leases.lose(attempt)
    start(record, job)
    found = row(record, job)
    assert (found["phase"], found["step"], found["steps"], found["phase_at"]) == (None, None, None, None)


def test_with_a_dead_workers_jobs_those_whose_lease_has_lapsed_are_taken_back(record: Record, clock: Clock) -> None:
    jobs = [add(record) for _ in range(3)]
    for job, owner, seconds in zip(jobs, ("dead", "lapsed", "alive"), (60, 5, 60), strict=True):
        start(record, job, owner, seconds)
    clock.advance(6)
    assert set(record.leases.take_back(owner="dead")) == {jobs[0].id, jobs[1].id}


def test_an_attempt_that_gets_less_far_does_not_lower_the_mark(record: Record) -> None:
    job, lost = add(record), []
    for step in (5, 2, 5):
        attempt = start(record, job)
        record.leases.progress(attempt, "attacking", step, 9, [])
        record.leases.lose(attempt)
        lost.append(row(record, job)["lost"])
    assert lost == [0, 1, 2]


def test_eight_workers_get_one_lease(record: Record) -> None:
    job = add(record)
    with ThreadPoolExecutor(8) as pool:
        leases = list(pool.map(lambda n: record.leases.lease(job.id, f"w{n}", 20), range(8)))
    assert sum(lease is not None for lease in leases) == 1


def test_success_records_result_artifacts_times_and_events(record: Record, clock: Clock) -> None:
    job = add(record)
    clock.advance(1)
    attempt = start(record, job)
    assert record.leases.progress(attempt, "attacking", 3, 120, [{"step": 3}])
    clock.advance(1)
    assert record.leases.succeed(attempt, {"spec": {}}, OUTCOME, [artifact(job)])
    found = row(record, job)
    assert (found["state"], found["result"], found["outcome"]) == (State.SUCCEEDED, {"spec": {}}, OUTCOME)
    assert (found["step"], found["steps"], found["lease_owner"]) == (3, 120, None)
    assert found["artifacts"] == ["result.json"]
    assert [event[:2] for event in found["events"]] == [
        (1, "state"),
        (2, "state"),
        (3, "progress"),
        (4, "state"),
    ]
    assert found["events"][2][2] == {"phase": "attacking", "step": 3, "steps": 120, "rows": [{"step": 3}]}
    assert found["events"][3][2]["outcome"] == OUTCOME


@pytest.mark.parametrize("write", ["progress", "succeed", "fail", "cancelled", "give_back", "lose", "renew"])
@pytest.mark.parametrize("since", ["taken back", "taken again", "over"])
def test_a_late_write_of_an_old_attempt_changes_nothing(record: Record, clock: Clock, write: str, since: str) -> None:
    job = add(record)
    old = start(record, job)
    clock.advance(21)
    record.leases.take_back()
    if since != "taken back":
        new = start(record, job)
        if since == "over":
            record.leases.fail(new, "internal", "because")
    before = row(record, job)
    writes = {
        "progress": lambda: record.leases.progress(old, "attacking", 1, 2, []),
        "succeed": lambda: record.leases.succeed(old, {}, OUTCOME, [artifact(job)]),
        "fail": lambda: record.leases.fail(old, "internal", "late"),
        "cancelled": lambda: record.leases.cancelled(old),
        "give_back": lambda: record.leases.give_back(old),
        "lose": lambda: record.leases.lose(old),
        "renew": lambda: record.leases.renew(old, 1000) is not Standing.LOST,
    }
    assert not writes[write]()
    assert row(record, job) == before
    assert record.leases.standing(old) is Standing.LOST


def test_a_result_and_its_artifacts_are_recorded_together_or_not_at_all(record: Record) -> None:
    job = add(record)
    attempt = start(record, job)
    before = row(record, job)
    with pytest.raises((StatementError, ValueError), match="JSON compliant"):
        record.leases.succeed(attempt, {"loss": nan}, OUTCOME, [artifact(job)])
    assert row(record, job) == before


def test_a_lease_lapses_unless_it_is_renewed(record: Record, clock: Clock) -> None:
    job = add(record)
    attempt = start(record, job, seconds=20)
    clock.advance(15)
    assert record.leases.renew(attempt, 20) is Standing.GO_ON
    clock.advance(15)
    assert record.leases.take_back() == []
    clock.advance(6)
    assert record.leases.take_back() == [job.id]
    found = record.jobs.get(job.id)
    assert found is not None
    assert (found.state, found.lost) == (State.QUEUED, 1)
    assert start(record, job).number == 2


def test_the_leases_of_a_dead_worker_are_taken_back_at_once(record: Record) -> None:
    dead, alive = add(record), add(record)
    start(record, dead, owner="dead")
    start(record, alive, owner="alive")
    assert record.leases.take_back(owner="dead") == [dead.id]
    assert state(record, alive.id) is State.RUNNING


def test_a_job_that_loses_its_process_too_often_fails(record: Record) -> None:
    job = add(record)
    for _ in range(MAX_ATTEMPTS - 1):
        record.leases.lose(start(record, job))
        assert state(record, job.id) is State.QUEUED
    record.leases.lose(start(record, job))
    found = record.jobs.get(job.id)
    assert found is not None
    assert (found.state, found.failure_kind, found.lost) == (State.FAILED, "worker-lost", MAX_ATTEMPTS)
    assert record.jobs.events(job.id, 0)[-1].data["failure"]["kind"] == "worker-lost"


def test_an_attempt_that_got_further_does_not_count(record: Record) -> None:
    job = add(record)
    ways = [("loading", 0), ("attacking", 3), ("attacking", 4), ("analysing", 0), ("analysing", 2)]
    losses = []
    for phase, step in ways:
        attempt = start(record, job)
        record.leases.progress(attempt, phase, step, 9, [])
        record.leases.lose(attempt)
        found = record.jobs.get(job.id)
        assert found is not None
        losses.append(found.lost)
    assert losses == [1, 0, 0, 0, 0]
    for expected in [
        *[State.QUEUED] * (MAX_ATTEMPTS - 1),
        State.FAILED,
    ]:  # it dies where it was, no further
        attempt = start(record, job)
        record.leases.progress(attempt, "attacking", 8, 9, [])
        record.leases.progress(attempt, "analysing", 2, 9, [])
        record.leases.lose(attempt)
        assert state(record, job.id) is expected


def test_a_job_given_back_is_not_counted_as_lost(record: Record) -> None:
    job = add(record)
    for _ in range(5):
        record.leases.give_back(start(record, job))
    found = record.jobs.get(job.id)
    assert found is not None
    assert (found.state, found.attempt, found.lost) == (State.QUEUED, 5, 0)


@pytest.mark.parametrize("end", ["give_back", "lose", "take_back"])
def test_a_job_that_was_to_stop_is_not_started_again(record: Record, clock: Clock, end: str) -> None:
    job = add(record)
    attempt = start(record, job)
    record.jobs.request_cancel(job.id)
    clock.advance(21)
    {
        "give_back": lambda: record.leases.give_back(attempt),
        "lose": lambda: record.leases.lose(attempt),
        "take_back": lambda: record.leases.take_back(),
    }[end]()
    assert state(record, job.id) is State.CANCELLED


def test_cancel_asks_once_and_changes_nothing_afterwards(record: Record, clock: Clock) -> None:
    queued, running, over = add(record), add(record), add(record)
    attempt = start(record, running)
    record.leases.fail(start(record, over), "internal", "because")
    for job, after in ((queued, State.CANCELLED), (running, State.CANCELLING), (over, State.FAILED)):
        first = record.jobs.request_cancel(job.id)
        clock.advance(1)
        again = record.jobs.request_cancel(job.id)
        assert first is not None
        assert again is not None
        assert (first.state, first.times, first.events) == (again.state, again.times, again.events)
        assert again.state is after
    assert record.leases.standing(attempt) is Standing.CANCEL
    assert record.leases.cancelled(attempt)
    assert state(record, running.id) is State.CANCELLED
    assert record.jobs.request_cancel("no such job") is None


def test_events_of_concurrent_writers_are_numbered_without_gaps(record: Record) -> None:
    job = add(record)
    attempt = start(record, job)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda n: record.leases.progress(attempt, "attacking", n, 40, []), range(40)))
    assert [event.number for event in record.jobs.events(job.id, 0)] == list(range(1, 43))
    assert [event.number for event in record.jobs.events(job.id, 40)] == [41, 42]


def test_pages_and_keys_are_those_of_an_owner(record: Record) -> None:
    def create(owner: str, digest: str) -> tuple[Job | None, dict[str, str]]:
        return record.jobs.create(SPEC, 9, Key("k", digest[:64], owner), lambda job: {"id": job.id}, owner=owner)

    made = {owner: create(owner, f"of {owner}")[1]["id"] for owner in ("", "alice", "bob", "x" * 100)}
    assert len(set(made.values())) == 4
    for owner, job_id in made.items():
        assert create(owner, f"of {owner}") == (None, {"id": job_id})
        assert [job.id for job in attacks(record, owner=owner)] == [job_id]
    assert len(attacks(record)) == 4


def test_an_owner_has_no_more_queued_jobs_than_it_may(record: Record) -> None:
    def create(owner: str, most: int | None = 2) -> Job:
        job, _ = record.jobs.create(SPEC, 100, None, lambda _: {}, owner=owner, owner_queued=most)
        assert job is not None
        return job

    first, _ = [create("alice") for _ in range(2)]
    with pytest.raises(QuotaExceeded, match="2 jobs queued"):
        create("alice")
    create("bob")
    create("alice", None)
    start(record, first)
    with pytest.raises(QuotaExceeded):
        create("alice")
    record.jobs.request_cancel(attacks(record, "state:queued", owner="alice")[0].id)
    create("alice")


def test_a_key_makes_one_job_however_often_it_comes(record: Record, tmp_path: Path) -> None:
    key = Key("k", "same")
    nowhere = Queue(connect(f"unix://{tmp_path}/none.sock"))
    submissions = Submissions(record, nowhere, Quotas(cast(Any, None), 10, 10, 10), cast(Any, None), 1000)

    async def submitted() -> list[JobView]:
        return await asyncio.gather(*(submissions.submit(SPEC, None, KEYLESS, NO_DEMAND, key) for _ in range(8)))

    assert len({job.id for job in asyncio.run(submitted())}) == 1
    assert len(attacks(record)) == 1
    with pytest.raises(KeyReused):
        record.jobs.create(SPEC, 1000, Key("k", "other"), lambda job: {"id": job.id})
    with pytest.raises(KeyReused):
        record.jobs.first_answer(Key("k", "other"))


def test_a_full_queue_takes_no_more(record: Record) -> None:
    started = add(record)
    record.jobs.create(SPEC, 2, None, lambda _: {})
    with pytest.raises(QueueFull):
        record.jobs.create(SPEC, 2, None, lambda _: {})
    start(record, started)
    record.jobs.create(SPEC, 2, None, lambda _: {})
    assert len(attacks(record)) == 3
