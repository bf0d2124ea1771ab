"""The watcher on a real record, in which the test plays the worker."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import aclosing
from pathlib import Path

import pytest
from sqlalchemy import Engine, event

from api import watcher as module
from api.watcher import Watcher
from services.jobs.database import connect, migrate
from services.jobs.models import Job
from services.jobs.repository import Repository
from services.settings import Settings
from tests.unit.jobs.records import add, start

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
def repository(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> Repository:
    monkeypatch.setattr(module, "POLL_SECONDS", 0.001)
    monkeypatch.setattr(module, "KEPT", KEPT)
    return Repository(engine)


def line(repository: Repository, job: Job) -> Job:
    found = repository.line(job.id)
    assert found is not None
    return found


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


def test_streams_get_every_event_once_and_in_order_whenever_they_begin(repository: Repository) -> None:
    job = add(repository)

    async def test() -> None:
        watcher = Watcher(repository)
        early = [asyncio.create_task(collect(watcher, line(repository, job))) for _ in range(3)]
        attempt = start(repository, job)
        for step in range(2 * KEPT):
            repository.progress(attempt, "attacking", step, 9, [])
            if step == KEPT:
                late = asyncio.create_task(collect(watcher, line(repository, job)))
                resumed = asyncio.create_task(collect(watcher, line(repository, job), 10))
            await asyncio.sleep(0)
        repository.fail(attempt, "internal", "")
        everything = list(range(1, 2 * KEPT + 4))
        for stream in (*early, late):
            assert await stream == everything
        assert await resumed == everything[10:]
        assert await collect(watcher, line(repository, job), 5) == everything[5:]
        watcher.close()

    run(test)


def test_a_slow_stream_that_fell_behind_reads_the_record(repository: Repository) -> None:
    job = add(repository)

    async def test() -> None:
        watcher = Watcher(repository)
        slow = numbers(watcher, line(repository, job))
        assert await anext(slow) == 1
        fast = asyncio.create_task(collect(watcher, line(repository, job)))
        attempt = start(repository, job)
        for step in range(3 * KEPT):
            repository.progress(attempt, "attacking", step, 9, [])
        repository.fail(attempt, "internal", "")
        everything = list(range(1, 3 * KEPT + 4))
        assert await fast == everything
        assert [number async for number in slow] == everything[1:]
        watcher.close()

    run(test)


def test_many_streams_cost_as_many_reads_as_one(repository: Repository, engine: Engine) -> None:
    jobs = [add(repository) for _ in range(20)]
    lines = [line(repository, job) for job in jobs]
    reads = []

    async def test() -> None:
        watcher = Watcher(repository)
        streams = [asyncio.create_task(collect(watcher, one, one.events)) for one in lines for _ in range(25)]
        await asyncio.sleep(0)
        for job in jobs:
            repository.request_cancel(job.id)
        event.listen(engine, "before_cursor_execute", lambda *said: reads.append(said[2]))
        assert await asyncio.gather(*streams) == [[2]] * 500
        watcher.close()

    run(test)
    assert 20 <= len(reads) < 100


def test_a_stream_of_a_deleted_job_ends(repository: Repository, engine: Engine) -> None:
    job = add(repository)

    async def test() -> None:
        watcher = Watcher(repository)
        stream = numbers(watcher, line(repository, job))
        assert await anext(stream) == 1
        with engine.execution_options(writes=True).begin() as connection:
            connection.exec_driver_sql("DELETE FROM jobs")
        assert [number async for number in stream] == []
        watcher.close()

    run(test)


def test_waiting_for_the_end_of_a_job_stops_in_time(repository: Repository) -> None:
    job = add(repository)

    async def test() -> None:
        watcher = Watcher(repository)
        assert not await watcher.until_over(line(repository, job), 0)
        over = asyncio.create_task(watcher.until_over(line(repository, job), LONG))
        repository.request_cancel(job.id)
        assert await over
        assert await watcher.until_over(line(repository, job), 0)
        watcher.close()

    run(test)
