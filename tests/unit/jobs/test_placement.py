"""Which worker is offered which job, in which order, and what a job that none can run says."""

from collections.abc import Iterator

import pytest

from scene_attack.client.states import Priority
from scene_attack.runs.spec import parse
from scene_attack_service.jobs.leases import Attempt
from scene_attack_service.jobs.models import Job
from scene_attack_service.jobs.queue import (
    NAME,
    Abilities,
    Demand,
    Needs,
    Queue,
    connect,
    reconcile,
    targets_of,
    why_waiting,
)
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import SPEC

pytestmark = pytest.mark.slow

LITE = "efficientnet-lite0"
CPU = Abilities("cpu", frozenset({LITE, "iep"}), 2**34)


@pytest.fixture
def queue(redis_url: str) -> Iterator[Queue]:
    redis = connect(redis_url)
    redis.flushall()
    yield Queue(redis)
    redis.flushall()
    redis.close()


def add(record: Record, owner: str = "", **asked: object) -> Job:
    demand = Demand(**asked)  # type: ignore[arg-type]
    job, _ = record.jobs.create(SPEC, 1000, None, lambda _: {}, owner=owner, demand=demand)
    assert job is not None
    return job


@pytest.mark.parametrize(
    ("needs", "lacking"),
    [
        (Needs(), None),
        (Needs((LITE, "iep"), "cpu", 2**34), None),
        (Needs((LITE, "resnet")), "the network 'resnet'"),
        (Needs((LITE,), "cuda"), "the device cuda"),
        (Needs((LITE,), None, 2**34 + 1), "17,179,869,185 bytes of memory for a job"),
    ],
)
def test_what_a_worker_lacks_for_a_job(needs: Needs, lacking: str | None) -> None:
    assert CPU.lacks(needs) == lacking
    assert Needs.read(needs.text) == needs


@pytest.mark.parametrize(
    "planted",
    [b"", b"junk", b"{}", b"[]", b'{"device": "cpu", "targets": [{}], "memory": 0}', b"[" * 100_000],
    ids=range(6),
)
def test_what_is_no_sign_of_a_worker_is_ignored(queue: Queue, planted: bytes) -> None:
    queue.redis.set(f"{NAME}:worker:planted", planted)
    queue.alive("one", CPU)
    assert queue.workers() == [CPU]


def test_a_job_needs_its_network_its_surrogate_and_those_of_the_transfer() -> None:
    scene = {"objects": [{"mesh": "primitive/sphere"}]}
    attack = {"renderer": "pyrender", "method": "p-rgf", "surrogate": "squeezenet"}
    asked = {"scene": scene, "attack": attack, "analysis": {"transfer": {"targets": ["other"]}}}
    spec = parse(asked).model_dump(mode="json")
    assert targets_of(spec) == [LITE, "squeezenet", "other"]
    assert targets_of({"views": [{"probe": spec}]}) == targets_of(spec)


def test_a_job_that_no_live_worker_can_run_says_why(record: Record, queue: Queue) -> None:
    job, cuda = add(record), add(record, device="cuda")

    def waiting() -> list[str | None]:
        reconcile(record.scheduler, queue)
        return [found.waiting for found in map(record.jobs.get, (job.id, cuda.id)) if found is not None]

    assert waiting() == ["no worker is running"] * 2
    queue.alive("one", CPU)
    assert waiting() == [None, "no worker that is running has the device cuda"]
    queue.alive("two", Abilities("cuda", frozenset({LITE}), 1))
    assert waiting() == [None, None]
    queue.gone("two")
    assert waiting()[1] is not None
    assert record.leases.lease(cuda.id, "w", 20) is not None
    found = record.jobs.get(cuda.id)
    assert found is not None
    assert found.waiting is None


def test_reasons_of_several_workers_are_said_together() -> None:
    workers = [CPU, Abilities("cuda", frozenset(), 2**40)]
    assert why_waiting(Needs((LITE,), "cuda"), workers) == (
        "no worker that is running has the device cuda or the network 'efficientnet-lite0'"
    )


def take(record: Record, clock: Clock, abilities: Abilities = CPU, priority: Priority = Priority.NORMAL) -> str:
    """Leases the next job of a priority, as a worker that a bell has woken, and ends it."""
    clock.advance(1)
    job_id = record.scheduler.next_job(priority, abilities)
    assert job_id is not None
    attempt = record.leases.lease(job_id, "w", 20)
    assert isinstance(attempt, Attempt)
    record.leases.fail(attempt, "internal", "because")
    return job_id


def test_owners_take_turns_whatever_order_they_came_in(record: Record, clock: Clock) -> None:
    many, few = [], []
    for jobs, owner in [(many, "many")] * 4 + [(few, "few")] * 2:
        jobs.append(add(record, owner).id)
        clock.advance(1)
    order = [take(record, clock) for _ in range(6)]
    assert order == [many[0], few[0], many[1], few[1], many[2], many[3]]


def test_a_job_that_was_interrupted_goes_before_new_ones(record: Record, clock: Clock) -> None:
    new = add(record, "a")
    clock.advance(1)
    interrupted = add(record, "a")
    attempt = record.leases.lease(interrupted.id, "w", 20)
    assert attempt is not None
    assert record.scheduler.next_job(Priority.NORMAL, CPU) == new.id
    record.leases.lose(attempt)
    assert record.scheduler.next_job(Priority.NORMAL, CPU) == interrupted.id


def test_an_owner_has_no_more_turns_by_asking_for_something_else_each_time(record: Record, clock: Clock) -> None:
    many, few = [], []
    for jobs, owner, memory in [(many, "many", k) for k in range(1, 5)] + [(few, "few", 0)] * 2:
        jobs.append(add(record, owner, memory=memory).id)
        clock.advance(1)
    order = [take(record, clock) for _ in range(6)]
    assert order == [many[0], few[0], many[1], few[1], many[2], many[3]]


def test_the_next_job_is_one_of_the_priority_that_the_worker_can_run(record: Record, clock: Clock) -> None:
    cuda = add(record, "c", device="cuda").id
    clock.advance(1)
    normal, high = add(record, "a").id, add(record, "b", priority=Priority.HIGH).id
    card = Abilities("cuda", frozenset({LITE}), 2**34)
    assert record.scheduler.next_job(Priority.NORMAL, CPU) == normal
    assert record.scheduler.next_job(Priority.LOW, card) is None
    order = [take(record, clock, CPU, Priority.HIGH), take(record, clock, card), take(record, clock, card)]
    assert order == [high, cuda, normal]
    assert record.scheduler.next_job(Priority.NORMAL, card) is None  # nothing is queued: the bell rang for nothing
