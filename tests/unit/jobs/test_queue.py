"""Bells, signs of life, and the supervisor's look at the queue and the record."""

import asyncio
import json
import zlib
from collections.abc import Iterator
from typing import Any, cast

import pytest
from rq.job import Job as Bell

from scene_attack.client.states import Priority
from scene_attack_api.submissions import Submissions
from scene_attack_service.access.caller import KEYLESS, Quotas
from scene_attack_service.jobs.queue import HEARTBEAT_SECONDS, NO_DEMAND, Abilities, Queue, connect, reconcile
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import SPEC, add, start

pytestmark = pytest.mark.slow

ABLE = Abilities("cpu", frozenset({"efficientnet-lite0"}), 2**34)


@pytest.fixture
def queue(redis_url: str) -> Iterator[Queue]:
    redis = connect(redis_url)
    redis.flushall()
    yield Queue(redis)
    redis.flushall()
    redis.close()


@pytest.fixture
def workers(queue: Queue) -> Queue:
    """The queue with two live workers."""
    queue.alive("a", ABLE)
    queue.alive("b", ABLE)
    return queue


def bells(queue: Queue) -> list[int]:
    """The number of bells of each priority."""
    return [queue.bells(priority) for priority in Priority]


def test_a_bell_is_a_name_in_json_and_no_more(queue: Queue) -> None:
    queue.ring(Priority.HIGH)
    [key] = queue.redis.scan_iter("rq:job:*")
    bell = Bell.fetch(key.decode().removeprefix("rq:job:"), connection=queue.redis, serializer="json")
    assert (bell.func_name, bell.args, bell.kwargs) == ("ring", [], {})
    data = queue.redis.hget(bell.key, "data")
    assert isinstance(data, bytes)
    assert json.loads(zlib.decompress(data)) == ["ring", None, [], {}]


def test_the_supervisor_rings_for_every_worker_where_a_job_waits_that_one_can_run(
    record: Record, workers: Queue
) -> None:
    add(record)
    add(record)
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 2, 0]
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 2, 0], "the bells have not been answered yet"
    workers.redis.flushall()  # Redis loses them, and does not know the workers until their next signs of life
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 0, 0]
    workers.alive("a", ABLE)
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 1, 0]


def test_nobody_rings_for_jobs_that_run_or_have_ended_or_that_no_worker_can_run(record: Record, queue: Queue) -> None:
    queue.alive("a", Abilities("cpu", frozenset(), 2**34))
    first, second = add(record), add(record)
    reconcile(record.scheduler, queue)
    assert bells(queue) == [0, 0, 0]
    queue.alive("a", ABLE)
    start(record, first)
    record.leases.cancelled(start(record, second))
    reconcile(record.scheduler, queue)
    assert bells(queue) == [0, 0, 0]


def test_the_supervisor_rings_for_a_job_that_is_given_back(record: Record, workers: Queue) -> None:
    attempt = start(record, add(record))
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 0, 0]
    record.leases.give_back(attempt)
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 2, 0]


def test_a_clock_that_is_put_back_holds_no_job_up(record: Record, workers: Queue, clock: Clock) -> None:
    add(record)
    clock.advance(-3600)
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 2, 0]


def test_a_job_is_taken_while_redis_is_away(record: Record, workers: Queue, tmp_path) -> None:  # type: ignore[no-untyped-def]
    nowhere = Queue(connect(f"unix://{tmp_path}/none.sock"))
    quotas = Quotas(cast(Any, None), 10, 10, 10)
    submissions = Submissions(record, nowhere, quotas, cast(Any, None), 10)
    job = asyncio.run(submissions.submit(SPEC, None, KEYLESS, NO_DEMAND, None))
    reconcile(record.scheduler, workers)
    assert bells(workers) == [0, 2, 0]
    assert record.scheduler.next_job(Priority.NORMAL, ABLE) == job.id


def test_signs_of_life_are_counted_and_do_not_last(queue: Queue) -> None:
    assert queue.live_workers() == 0
    queue.alive("a")
    queue.alive("a")
    queue.alive("b")
    assert queue.live_workers() == 2
    queue.gone("a")
    assert queue.live_workers() == 1
    assert 0 < queue.redis.ttl("scene-attack:worker:b") <= 3 * HEARTBEAT_SECONDS
