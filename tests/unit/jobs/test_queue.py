import asyncio
import json
import zlib
from collections.abc import Iterator
from typing import Any, cast

import pytest
from rq.job import Job as Message

from api.submissions import Submissions
from services.access.caller import KEYLESS
from services.access.quotas import Quotas
from services.jobs import reconciler
from services.jobs.placement import NO_DEMAND
from services.jobs.queue import HEARTBEAT_SECONDS, TASK, Queue, connect
from services.jobs.reconciler import SETTLE_SECONDS, Reconciler
from services.jobs.repository import Repository
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import SPEC, add, start

pytestmark = pytest.mark.slow


@pytest.fixture
def queue(redis_url: str) -> Iterator[Queue]:
    redis = connect(redis_url)
    redis.flushall()
    yield Queue(redis)
    redis.close()


def lost(queue: Queue) -> None:
    """What Redis looks like after it was restarted."""
    queue.redis.flushall()


def taken_and_dropped(queue: Queue) -> None:
    """What Redis looks like after a worker took the message and died: its list is empty, its hash is there."""
    assert queue.redis.delete(*queue.redis.scan_iter("rq:queue:*")) == 1


def test_a_message_is_a_name_and_an_id_in_json(queue: Queue) -> None:
    queue.send("abc", 0)
    (message_id,) = queue.waiting()
    message = Message.fetch(message_id, connection=queue.redis, serializer="json")
    assert (message.func_name, message.args, message.kwargs) == (TASK, ["abc"], {})
    data = queue.redis.hget(message.key, "data")
    assert isinstance(data, bytes)
    assert json.loads(zlib.decompress(data)) == ["run_job", None, ["abc"], {}]


def test_a_job_is_sent_once_however_often_it_is_tried(repository: Repository, queue: Queue) -> None:
    job = add(repository)
    queue.send(job.id, 0)
    queue.send(job.id, 0)
    Reconciler(repository, queue).look()
    assert repository.unsent(1) == [], "its sender died before it had recorded that it was sent"
    (name,) = queue.redis.scan_iter("rq:queue:*")
    assert queue.redis.llen(name) == 1


def test_what_was_recorded_but_never_sent_is_sent(repository: Repository, queue: Queue) -> None:
    first, second = add(repository), add(repository)
    assert Reconciler(repository, queue).look() == 2
    assert queue.waiting() == {f"{first.id}-0", f"{second.id}-0"}
    assert Reconciler(repository, queue).look() == 0


@pytest.mark.parametrize("accident", [lost, taken_and_dropped])
def test_what_redis_lost_is_sent_again(repository: Repository, queue: Queue, clock: Clock, accident) -> None:  # type: ignore[no-untyped-def]
    job = add(repository)
    assert Reconciler(repository, queue).look() == 1
    accident(queue)
    clock.advance(SETTLE_SECONDS + 1)
    assert Reconciler(repository, queue).look() == 1
    assert queue.waiting() == {f"{job.id}-0"}


def test_a_look_is_at_few_jobs_and_all_get_their_turn(
    repository: Repository, queue: Queue, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconciler, "AT_ONCE", 3)
    jobs = [add(repository) for _ in range(8)]  # all of one time, so that their ids order them
    steady = Reconciler(repository, queue)
    first = [steady.look() for _ in range(4)]
    assert max(first) <= 2 * 3
    assert sum(first) == 8
    lost(queue)
    clock.advance(SETTLE_SECONDS + 1)
    newest = add(repository)
    sent = [steady.look() for _ in range(4)]
    assert max(sent) <= 2 * 3
    assert sum(sent) == 9
    assert queue.waiting() == {f"{job.id}-0" for job in [*jobs, newest]}


def test_every_reason_to_wait_is_found_in_turn(
    repository: Repository, queue: Queue, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reconciler, "AT_ONCE", 3)
    jobs = [add(repository) for _ in range(8)]
    for job in jobs:
        repository.sent(job.id, 0)
    steady = Reconciler(repository, queue)
    for _ in range(3):
        steady.look()
    assert {found.why for found in repository.queued()} == {"no worker is running"}


def test_a_message_just_taken_is_not_sent_again(repository: Repository, queue: Queue) -> None:
    add(repository)
    Reconciler(repository, queue).look()
    taken_and_dropped(queue)
    assert Reconciler(repository, queue).look() == 0


def test_a_clock_that_is_put_back_holds_no_job_up(repository: Repository, queue: Queue, clock: Clock) -> None:
    job = add(repository)
    Reconciler(repository, queue).look()
    lost(queue)
    clock.advance(-3600)
    assert Reconciler(repository, queue).look() == 1
    assert queue.waiting() == {f"{job.id}-0"}


def test_only_queued_jobs_are_sent(repository: Repository, queue: Queue) -> None:
    start(repository, add(repository))
    repository.request_cancel(add(repository).id)
    assert Reconciler(repository, queue).look() == 0


def test_a_job_given_back_is_sent_for_its_next_attempt(repository: Repository, queue: Queue) -> None:
    job = add(repository)
    Reconciler(repository, queue).look()
    repository.give_back(start(repository, job))
    assert Reconciler(repository, queue).look() == 1
    assert f"{job.id}-1" in queue.waiting()


def test_a_job_is_taken_while_redis_is_away(repository: Repository, queue: Queue, tmp_path) -> None:  # type: ignore[no-untyped-def]
    nowhere = Queue(connect(f"unix://{tmp_path}/none.sock"))
    quotas = Quotas(cast(Any, None), 10, 10, 10)
    submissions = Submissions(repository, nowhere, quotas, cast(Any, None), 10)
    job = asyncio.run(submissions.submit(SPEC, None, KEYLESS, NO_DEMAND, None))
    assert Reconciler(repository, queue).look() == 1
    assert queue.waiting() == {f"{job.id}-0"}


def test_signs_of_life_are_counted_and_do_not_last(queue: Queue) -> None:
    assert queue.live_workers() == 0
    queue.alive("a")
    queue.alive("a")
    queue.alive("b")
    assert queue.live_workers() == 2
    queue.gone("a")
    assert queue.live_workers() == 1
    assert 0 < queue.redis.ttl("scene-attack:worker:b") <= 3 * HEARTBEAT_SECONDS
