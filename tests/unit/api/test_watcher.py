"""The watcher on a real record, in which the test plays the worker."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import aclosing
from pathlib import Path

import pytest
from sqlalchemy import Engine, event

from scene_attack_api import watchers as module
from scene_attack_api.watchers import Watcher
from scene_attack_service.access.caller import Scope
from scene_attack_service.access.keys import AccessKeys
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.models import Job, State
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from tests.unit.jobs.records import add, start

pytestmark = pytest.mark.slow

LONG = 20.0
KEPT = 8


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    settings = Settings(data=tmp_path)
    engine = connect(settings)
    migrate(engine, settings)
    yield engine
    engine.dispose()


@pytest.fixture
def record(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> Record:
    monkeypatch.setattr(module, "POLL_SECONDS", 0.001)
    monkeypatch.setattr(module, "KEPT", KEPT)
    return Record(engine)


def line(record: Record, job: Job) -> Job:
    found = record.jobs.line(job.id)
    assert found is not None
    return found


def watching(record: Record, engine: Engine) -> Watcher:
    return Watcher(record, AccessKeys(engine))


async def numbers(watcher: Watcher, job: Job, after: int = 0) -> AsyncIterator[int]:
    async with aclosing(watcher.events(job, after)) as events:
        async for one in events:
            yield one.number


async def collect(watcher: Watcher, job: Job, after: int = 0) -> list[int]:
    return [number async for number in numbers(watcher, job, after)]


def run(test: Callable[[], Awaitable[None]]) -> None:
    async def whole() -> None:
        async with asyncio.timeout(LONG):
            await test()

    asyncio.run(whole())


def test_streams_get_every_event_once_and_in_order_whenever_they_begin(record: Record, engine: Engine) -> None:
    job = add(record)

    async def test() -> None:
        watcher = watching(record, engine)
        early = [asyncio.create_task(collect(watcher, line(record, job))) for _ in range(3)]
        attempt = start(record, job)
        for step in range(2 * KEPT):
            record.leases.progress(attempt, "attacking", step, 9, [])
            if step == KEPT:
                late = asyncio.create_task(collect(watcher, line(record, job)))
                resumed = asyncio.create_task(collect(watcher, line(record, job), 10))
            await asyncio.sleep(0)
        record.leases.fail(attempt, "internal", "")
        everything = list(range(1, 2 * KEPT + 4))
        for stream in (*early, late):
            assert await stream == everything
        assert await resumed == everything[10:]
        assert await collect(watcher, line(record, job), 5) == everything[5:]
        watcher.close()

    run(test)


def test_a_slow_stream_that_fell_behind_reads_the_record(record: Record, engine: Engine) -> None:
    job = add(record)

    async def test() -> None:
        watcher = watching(record, engine)
        slow = numbers(watcher, line(record, job))
        assert await anext(slow) == 1
        fast = asyncio.create_task(collect(watcher, line(record, job)))
        attempt = start(record, job)
        for step in range(3 * KEPT):
            record.leases.progress(attempt, "attacking", step, 9, [])
        record.leases.fail(attempt, "internal", "")
        everything = list(range(1, 3 * KEPT + 4))
        assert await fast == everything
        assert [number async for number in slow] == everything[1:]
        watcher.close()

    run(test)


def test_many_streams_cost_as_many_reads_as_one(record: Record, engine: Engine) -> None:
    jobs = [add(record) for _ in range(20)]
    lines = [line(record, job) for job in jobs]
    reads = []

    async def test() -> None:
        watcher = watching(record, engine)
        streams = [asyncio.create_task(collect(watcher, one, one.events)) for one in lines for _ in range(25)]
        await asyncio.sleep(0)
        for job in jobs:
            record.jobs.request_cancel(job.id)
        event.listen(engine, "before_cursor_execute", lambda *said: reads.append(said[2]))
        assert await asyncio.gather(*streams) == [[2]] * 500
        watcher.close()

    run(test)
    assert 20 <= len(reads) < 100


def test_a_stream_of_a_deleted_job_ends(record: Record, engine: Engine) -> None:
    job = add(record)

    async def test() -> None:
        watcher = watching(record, engine)
        stream = numbers(watcher, line(record, job))
        assert await anext(stream) == 1
        with engine.execution_options(writes=True).begin() as connection:
            connection.exec_driver_sql("DELETE FROM jobs")
        assert [number async for number in stream] == []
        watcher.close()

    run(test)


@pytest.mark.parametrize("has_key", [True, False])
def test_a_stream_ends_with_its_key_and_others_go_on(
    record: Record, engine: Engine, monkeypatch: pytest.MonkeyPatch, has_key: bool
) -> None:
    monkeypatch.setattr("scene_attack_api.watchers.KEY_SECONDS", 0.0)
    keys = AccessKeys(engine)
    prefixes = [keys.create(name, "alice", {Scope.JOBS_READ})[0].prefix for name in "ab"] if has_key else ["", ""]
    reads = []

    async def test() -> None:
        watcher = watching(record, engine)

        async def follow(job: Job, key: str | None) -> list[int]:
            async with aclosing(watcher.events(line(record, job), 0, key)) as events:
                return [one.number async for one in events]

        job = add(record)
        event.listen(engine, "before_cursor_execute", lambda *said: reads.append("access_keys" in said[2]))
        ending = [asyncio.create_task(follow(job, prefixes[0])) for _ in range(100)]
        others = [asyncio.create_task(follow(job, None)), asyncio.create_task(follow(job, prefixes[1]))]
        await asyncio.sleep(0)
        if has_key:
            keys.revoke(prefixes[0])
        else:
            keys.create("first", "alice", {Scope.JOBS_READ})
        assert await asyncio.gather(*ending) == [[1]] * 100
        if has_key:
            assert not any(other.done() for other in others)
        record.jobs.request_cancel(job.id)
        assert await others[0] == [1, 2]
        assert await others[1] == ([1, 2] if has_key else [1])
        watcher.close()

    run(test)
    assert sum(reads) < 100  # not one for each stream


def test_waiting_for_the_end_of_a_job_stops_in_time(record: Record, engine: Engine) -> None:
    job = add(record)

    async def test() -> None:
        watcher = watching(record, engine)
        assert await watcher.ended_within(job.id, 0) is None
        ending = asyncio.create_task(watcher.ended_within(job.id, LONG))
        record.jobs.request_cancel(job.id)
        for ended in (await ending, await watcher.ended_within(job.id, 0)):
            assert ended is not None
            assert ended.state is State.CANCELLED
        watcher.close()

    run(test)
