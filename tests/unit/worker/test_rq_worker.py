"""The worker's messages, taken from a real Redis, with a runner that only notes what it was asked to run."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rq
from redis import Redis
from rq import Callback, Retry

from services.jobs.placement import ANY_WORKER, NOTHING, Abilities, Needs, Priority
from services.jobs.queue import TASK, Queue, connect, queue_name
from services.settings import Settings
from worker.rq_worker import JobWorker
from worker.runner import Runner

pytestmark = pytest.mark.slow

ID = "0123456789abcdef" * 2
NAME = queue_name(Priority.NORMAL, ANY_WORKER)


class Noting(Runner):
    """Notes the ids."""

    def __init__(self) -> None:
        super().__init__(Settings(), None, "w")  # type: ignore[arg-type]
        self.seen: list[str] = []

    def ensure_ready(self) -> None:
        pass

    def usable(self) -> bool:
        return True

    def run(self, job_id: str, beat: Callable[[], None]) -> None:
        beat()
        self.seen.append(job_id)


@pytest.fixture
def redis(redis_url: str) -> Iterator[Redis]:
    with connect(redis_url) as client:
        client.flushall()
        yield client


@pytest.fixture
def runner() -> Noting:
    return Noting()


@pytest.fixture
def worker(redis: Redis, runner: Noting) -> JobWorker:
    return JobWorker(runner, name="w", connection=redis)


def work(worker: JobWorker) -> None:
    """Takes one message off the queue."""
    worker.execute_job(*worker.dequeue_job_and_maintain_ttl(1))


def test_a_message_runs_its_job_and_leaves_nothing_in_redis(redis: Redis, worker: JobWorker, runner: Noting) -> None:
    queue = Queue(redis)
    queue.send(ID, 0)
    work(worker)
    assert runner.seen == [ID]
    assert queue.live_workers() == 1
    assert list(redis.scan_iter("rq:job:*")) == list(redis.scan_iter("rq:queue:*")) == []
    queue.send(ID, 0)  # the same message may come again
    work(worker)
    assert runner.seen == [ID, ID]


@pytest.mark.parametrize(
    ("function", "arguments", "named"),
    [
        ("os.mkdir", ["FOLDER"], {}),
        (TASK, [ID, ID], {}),
        (TASK, [], {"job_id": ID}),
        (TASK, ["../../etc/passwd"], {}),
        (TASK, [ID + "0"], {}),
        (TASK, [7], {}),
    ],
)
def test_a_planted_message_runs_nothing(
    redis: Redis,
    worker: JobWorker,
    runner: Noting,
    tmp_path: Path,
    function: str,
    arguments: list[Any],
    named: dict[str, Any],
) -> None:
    folder = tmp_path / "made"
    said = [str(folder) if argument == "FOLDER" else argument for argument in arguments]
    rq.Queue(NAME, connection=redis, serializer="json").enqueue_call(function, args=said, kwargs=named)
    work(worker)
    assert runner.seen == []
    assert not folder.exists()
    assert list(redis.scan_iter("rq:job:*")) == []


def test_callbacks_retries_and_dependents_of_a_message_are_not_run(
    redis: Redis, worker: JobWorker, runner: Noting
) -> None:
    planted = Callback("tests.unit.worker.test_rq_worker.explode")
    queue = rq.Queue(NAME, connection=redis, serializer="json")
    first = queue.enqueue_call(
        TASK, args=[ID], retry=Retry(3), on_success=planted, on_failure=planted, on_stopped=planted
    )
    queue.enqueue_call("os.getpid", depends_on=first)
    work(worker)
    assert runner.seen == [ID]
    worker.run_maintenance_tasks()
    assert Queue(redis).waiting() == set()


def test_maintenance_leaves_a_planted_message_alone(
    redis: Redis, worker: JobWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """RQ's own maintenance would import and call the failure callback of a message that seems to run for too long."""
    ran: list[object] = []
    monkeypatch.setitem(globals(), "explode", lambda *said: ran.append(said))
    queue = rq.Queue(NAME, connection=redis, serializer="json")
    message = queue.enqueue_call(TASK, args=[ID], on_failure=Callback("tests.unit.worker.test_rq_worker.explode"))
    redis.zadd(queue.started_job_registry.key, {f"{message.id}:run": 1})
    worker.run_maintenance_tasks()
    assert ran == []


def explode(*_: object) -> None:
    raise AssertionError("a callback was called")


def test_messages_of_a_higher_priority_come_first_and_queues_of_one_take_turns(
    redis: Redis, worker: JobWorker, runner: Noting
) -> None:
    queue = Queue(redis)
    ids = [digit * 32 for digit in "abcdef"]
    places = [
        (Priority.LOW, ANY_WORKER),
        *[(Priority.NORMAL, ANY_WORKER)] * 2,
        *[(Priority.NORMAL, Needs((), "cpu"))] * 2,
    ]
    for job_id, (priority, needs) in zip(ids, [*places, (Priority.HIGH, ANY_WORKER)], strict=True):
        queue.send(job_id, 0, priority, needs)
    for _ in ids:
        work(worker)
    assert [seen[0] for seen in runner.seen] == ["f", "d", "b", "e", "c", "a"]


def test_a_worker_announces_what_it_has(redis: Redis, worker: JobWorker) -> None:
    worker.heartbeat()
    assert Queue(redis).workers() == [NOTHING]
    assert Abilities.of(NOTHING.record()) == NOTHING


def test_a_wait_for_messages_is_longer_than_that_for_other_answers(redis_url: str, runner: Noting) -> None:
    with connect(redis_url) as fresh:
        worker = JobWorker(runner, name="w", connection=fresh)
        worker.heartbeat()
        waits = fresh.connection_pool.get_connection().socket_timeout
        assert worker.dequeue_timeout < waits < Settings().lease_seconds  # it also beats while a job runs


def test_dead_workers_are_forgotten(redis: Redis, worker: JobWorker) -> None:
    worker.register_birth()
    redis.sadd("rq:workers", "rq:worker:dead")
    redis.sadd(f"rq:workers:{NAME}", "rq:worker:dead")
    worker.run_maintenance_tasks()
    assert redis.smembers("rq:workers") == redis.smembers(f"rq:workers:{NAME}") == {b"rq:worker:w"}
