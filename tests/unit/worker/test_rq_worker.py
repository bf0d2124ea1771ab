"""The worker's bells, taken from a real Redis, with a runner that only notes what it was asked to run."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rq
from redis import Redis
from rq import Callback, Retry

from scene_attack.client.states import Priority
from scene_attack_service.jobs.queue import NOTHING, Queue, connect, queue_name
from scene_attack_service.settings import Settings
from scene_attack_worker.rq_worker import JobWorker, Runner

pytestmark = pytest.mark.slow

NAME = queue_name(Priority.NORMAL)


class Noting(Runner):
    """Notes the priorities."""

    def __init__(self) -> None:
        super().__init__(Settings(), None, "w")  # type: ignore[arg-type]
        self.seen: list[Priority] = []

    def ensure_ready(self) -> None:
        pass

    def usable(self) -> bool:
        return True

    def run(self, priority: Priority, beat: Callable[[], None]) -> None:
        beat()
        self.seen.append(priority)


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
    """Answers one bell."""
    worker.execute_job(*worker.dequeue_job_and_maintain_ttl(1))


def test_a_bell_asks_for_a_job_and_leaves_nothing_in_redis(redis: Redis, worker: JobWorker, runner: Noting) -> None:
    queue = Queue(redis)
    queue.ring(times=2)
    work(worker)
    assert runner.seen == [Priority.NORMAL]
    assert queue.live_workers() == 1
    work(worker)
    assert list(redis.scan_iter("rq:job:*")) == list(redis.scan_iter("rq:queue:*")) == []
    assert runner.seen == [Priority.NORMAL] * 2


@pytest.mark.parametrize(("function", "arguments"), [("os.mkdir", ["FOLDER"]), ("ring", [{"a": 1}]), ("", [])])
def test_nothing_that_a_planted_message_names_is_run(
    redis: Redis, worker: JobWorker, runner: Noting, tmp_path: Path, function: str, arguments: list[Any]
) -> None:
    folder = tmp_path / "made"
    said = [str(folder) if argument == "FOLDER" else argument for argument in arguments]
    rq.Queue(NAME, connection=redis, serializer="json").enqueue_call(function, args=said)
    work(worker)
    assert runner.seen == [Priority.NORMAL]  # it has rung, no more
    assert not folder.exists()
    assert list(redis.scan_iter("rq:job:*")) == []


def test_callbacks_retries_and_dependents_of_a_message_are_not_run(
    redis: Redis, worker: JobWorker, runner: Noting
) -> None:
    planted = Callback("tests.unit.worker.test_rq_worker.explode")
    queue = rq.Queue(NAME, connection=redis, serializer="json")
    first = queue.enqueue_call("ring", retry=Retry(3), on_success=planted, on_failure=planted, on_stopped=planted)
    queue.enqueue_call("os.getpid", depends_on=first)
    work(worker)
    assert runner.seen == [Priority.NORMAL]
    worker.run_maintenance_tasks()
    assert Queue(redis).bells(Priority.NORMAL) == 0


def test_maintenance_leaves_a_planted_message_alone(
    redis: Redis, worker: JobWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """RQ's own maintenance would import and call the failure callback of a message that seems to run for too long."""
    ran: list[object] = []
    monkeypatch.setitem(globals(), "explode", lambda *said: ran.append(said))
    queue = rq.Queue(NAME, connection=redis, serializer="json")
    message = queue.enqueue_call("ring", on_failure=Callback("tests.unit.worker.test_rq_worker.explode"))
    redis.zadd(queue.started_job_registry.key, {f"{message.id}:run": 1})
    worker.run_maintenance_tasks()
    assert ran == []


def explode(*_: object) -> None:
    raise AssertionError("a callback was called")


def test_bells_of_a_higher_priority_are_answered_first(redis: Redis, worker: JobWorker, runner: Noting) -> None:
    queue = Queue(redis)
    for priority in (Priority.LOW, Priority.NORMAL, Priority.LOW, Priority.HIGH, Priority.NORMAL):
        queue.ring(priority)
    for _ in range(5):
        work(worker)
    assert runner.seen == [Priority.HIGH, *[Priority.NORMAL] * 2, *[Priority.LOW] * 2]


def test_a_worker_announces_what_it_has(redis: Redis, worker: JobWorker) -> None:
    worker.heartbeat()
    assert Queue(redis).workers() == [NOTHING]


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
