"""Which worker is offered which job, in which order, and what a job that none can run says."""

from collections.abc import Iterator

import pytest

from services.jobs.attempts import Attempt
from services.jobs.models import Job
from services.jobs.placement import ANY_WORKER, Abilities, Demand, Needs, Priority, targets_of, why_waiting
from services.jobs.queue import NAME, Queue, connect, queue_name
from services.jobs.reconciler import Reconciler
from services.jobs.repository import Repository
from services.pipeline.spec import parse
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
    redis.close()


def add(repository: Repository, owner: str = "", **asked: object) -> Job:
    demand = Demand(**asked)  # type: ignore[arg-type]
    job, _ = repository.create(SPEC, 1000, None, lambda _: {}, owner=owner, demand=demand)
    assert job is not None
    return job


@pytest.mark.parametrize(
    ("needs", "lacking"),
    [
        (ANY_WORKER, None),
        (Needs((LITE, "iep"), "cpu", 2**34), None),
        (Needs((LITE, "resnet")), "the network 'resnet'"),
        (Needs((LITE,), "cuda"), "the device cuda"),
        (Needs((LITE,), None, 2**34 + 1), "17,179,869,185 bytes of memory for a job"),
    ],
)
def test_a_worker_takes_only_what_it_can_run(queue: Queue, needs: Needs, lacking: str | None) -> None:
    assert CPU.lacks(needs) == lacking
    queue.send("a" * 32, 0, Priority.NORMAL, needs)
    assert (queue_name(Priority.NORMAL, needs) in queue.for_worker(CPU)) == (lacking is None)
    assert queue.waiting() == {f"{'a' * 32}-0"}


def test_queues_are_listened_to_in_the_order_of_their_priorities(queue: Queue) -> None:
    queue.send("a" * 32, 0, Priority.HIGH, Needs((LITE, "iep")))
    found = [name.split(":")[1] for name in queue.for_worker(CPU)]
    assert found == ["high"] * 4 + ["normal"] * 4 + ["low"] * 4  # any, two networks, and both together


@pytest.mark.parametrize(
    "planted",
    [
        f"{NAME}:normal:",
        f"{NAME}:normal:[1]",
        f"{NAME}:normal:[[], {{}}, 0]",
        f"{NAME}:normal:[[], null, 1e999]",
        f"{NAME}:normal:[[{{}}], null, 0]",
        f"{NAME}:normal:{'[' * 100_000}",
        f"{NAME}:x:y",
    ],
    ids=range(7),
)
def test_what_is_no_queue_of_the_service_is_not_listened_to(queue: Queue, planted: str) -> None:
    before = queue.for_worker(CPU)
    queue.redis.sadd("rq:queues", f"rq:queue:{NAME}:{planted}")
    assert queue.for_worker(CPU) == before


@pytest.mark.parametrize(
    "planted",
    [b"", b"junk", b"{}", b"[]", b'{"device": "cpu", "targets": [{}], "memory": 0}', b"[" * 100_000],
    ids=range(6),
)
def test_what_is_no_sign_of_a_worker_is_ignored(queue: Queue, planted: bytes) -> None:
    queue.redis.set(f"{NAME}:worker:planted", planted)
    queue.alive("one", CPU)
    assert queue.workers() == [CPU]


def test_what_is_no_queue_keeps_no_job_from_being_sent(repository: Repository, queue: Queue) -> None:
    queue.redis.set(f"rq:queue:{NAME}:normal:planted", "a text")
    queue.redis.sadd("rq:queues", f"rq:queue:{NAME}:normal:planted")
    queue.redis.rpush(f"rq:queue:{NAME}:normal:other", b"\xff")
    queue.redis.sadd("rq:queues", f"rq:queue:{NAME}:normal:other")
    add(repository)
    assert Reconciler(repository, queue).look() == 1


def test_a_job_needs_its_network_its_surrogate_and_those_of_the_transfer() -> None:
    scene = {"objects": [{"mesh": "primitive/sphere"}]}
    attack = {"renderer": "pyrender", "method": "p-rgf", "surrogate": "squeezenet"}
    asked = {"scene": scene, "attack": attack, "analysis": {"transfer": {"targets": ["other"]}}}
    spec = parse(asked).model_dump(mode="json")
    assert targets_of(spec) == [LITE, "squeezenet", "other"]
    assert targets_of({"views": [{"probe": spec}]}) == targets_of(spec)


def test_a_job_that_no_live_worker_can_run_says_why(repository: Repository, queue: Queue) -> None:
    job, cuda = add(repository), add(repository, device="cuda")

    def waiting() -> list[str | None]:
        Reconciler(repository, queue).look()
        return [found.waiting for found in map(repository.get, (job.id, cuda.id)) if found is not None]

    assert waiting() == ["no worker is running"] * 2
    queue.alive("one", CPU)
    assert waiting() == [None, "no worker that is running has the device cuda"]
    queue.alive("two", Abilities("cuda", frozenset({LITE}), 1))
    assert waiting() == [None, None]
    queue.gone("two")
    assert waiting()[1] is not None
    assert repository.lease(cuda.id, "w", 20) is not None
    found = repository.get(cuda.id)
    assert found is not None
    assert found.waiting is None


def test_reasons_of_several_workers_are_said_together() -> None:
    workers = [CPU, Abilities("cuda", frozenset(), 2**40)]
    assert why_waiting(Needs((LITE,), "cuda"), workers) == (
        "no worker that is running has the device cuda or the network 'efficientnet-lite0'"
    )


def take(repository: Repository, job_id: str, clock: Clock, abilities: Abilities = CPU) -> str:
    """Leases the job whose turn it is, as a worker that was given `job_id`, and ends it."""
    clock.advance(1)
    turn = repository.turn(job_id, abilities)
    assert turn is not None
    attempt = repository.lease(turn, "w", 20)
    assert isinstance(attempt, Attempt)
    repository.fail(attempt, "internal", "because")
    return turn


def test_owners_take_turns_whatever_order_they_came_in(repository: Repository, clock: Clock) -> None:
    many, few = [], []
    for jobs, owner in [(many, "many")] * 4 + [(few, "few")] * 2:
        jobs.append(add(repository, owner).id)
        clock.advance(1)
    order = [take(repository, job_id, clock) for job_id in [*many, *few]]
    assert order == [many[0], few[0], many[1], few[1], many[2], many[3]]


def test_a_job_that_was_interrupted_goes_before_new_ones(repository: Repository, clock: Clock) -> None:
    interrupted, new = add(repository, "a"), add(repository, "a")
    attempt = repository.lease(interrupted.id, "w", 20)
    assert attempt is not None
    clock.advance(1)
    repository.lose(attempt, 5)
    assert repository.turn(new.id, CPU) == interrupted.id


def test_an_owner_has_no_more_turns_by_asking_for_something_else_each_time(
    repository: Repository, clock: Clock
) -> None:
    many, few = [], []
    for jobs, owner, memory in [(many, "many", k) for k in range(1, 5)] + [(few, "few", 0)] * 2:
        jobs.append(add(repository, owner, memory=memory).id)
        clock.advance(1)
    order = [take(repository, job_id, clock) for job_id in [*many, *few]]
    assert order == [many[0], few[0], many[1], few[1], many[2], many[3]]


def test_a_turn_is_among_jobs_of_the_same_priority_that_the_worker_can_run(
    repository: Repository, clock: Clock
) -> None:
    normal, high = add(repository, "a").id, add(repository, "b", priority=Priority.HIGH).id
    cuda = add(repository, "c", device="cuda").id
    card = Abilities("cuda", frozenset({LITE}), 2**34)
    assert repository.turn(cuda, CPU) == normal
    order = [take(repository, job_id, clock, worker) for job_id, worker in ((high, CPU), (cuda, card), (normal, card))]
    assert order == [high, normal, cuda]
    assert repository.turn(normal, CPU) is None  # nothing is queued: its message is dropped
    assert repository.turn("none", CPU) is None


def test_empty_queues_are_forgotten_if_there_are_many(queue: Queue) -> None:
    queue.send("a" * 32, 0, Priority.NORMAL, Needs((LITE,), None, 7))
    empty = [f"rq:queue:{queue_name(Priority.NORMAL, Needs((LITE,), None, k))}" for k in range(100, 300)]
    queue.redis.sadd("rq:queues", "rq:queue:of something else", *empty)
    assert queue.waiting() == {f"{'a' * 32}-0"}
    assert queue.redis.scard("rq:queues") == 2
    assert queue_name(Priority.NORMAL, Needs((LITE,), None, 7)) in queue.for_worker(CPU)
