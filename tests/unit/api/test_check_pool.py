"""The pool with processes that answer when the test says so, so that nothing depends on the machine's speed."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, BinaryIO

import pytest

from api.check_pool import CheckPool, NoneFree, Request
from api.warm_process import TooSlow, Unavailable
from services.errors import InvalidRequest
from services.jobs.child import ChildDied, OutOfMemory

LONG, NOT_AT_ALL = 60.0, 0.0


class ToldProcess:
    """Answers each request, in order of `asked`, with what the test puts into `answers`."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.answers: asyncio.Queue[dict[str, Any] | Exception] = asyncio.Queue()

    async def start(self) -> None:
        pass

    async def ask(self, message: dict[str, Any], file: BinaryIO | None, seconds: float) -> dict[str, Any]:
        self.asked.append(message["name"])
        answer = await self.answers.get()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        pass


def request(name: str, cost: float = 1) -> Request:
    return Request(name, {"name": name}, cost)


def run(test: Callable[[CheckPool, ToldProcess], Awaitable[None]], wait: float = LONG, seconds: float = LONG) -> None:
    async def inside() -> None:
        process = ToldProcess()
        pool = CheckPool([process], wait, seconds)
        pool.start()
        await test(pool, process)
        pool.close()

    asyncio.run(inside())


async def until_asked(process: ToldProcess, count: int) -> None:
    async with asyncio.timeout(LONG):
        while len(process.asked) < count:
            await asyncio.sleep(0)


def test_a_check_is_made_once_and_remembered() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        process.answers.put_nowait({"spec": 1})
        both = await asyncio.gather(pool.check(request("a"), "x"), pool.check(request("a"), "y"))
        assert [*both, await pool.check(request("a"), "z")] == [{"spec": 1}] * 3
        assert process.asked == ["a"]

    run(test)


def test_an_invalid_field_is_remembered_too() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        process.answers.put_nowait(InvalidRequest("goal.leave", "no such label"))
        for _ in range(2):
            with pytest.raises(InvalidRequest, match="no such label"):
                await pool.check(request("a"), "x")
        assert process.asked == ["a"]

    run(test)


@pytest.mark.parametrize("trouble", [Unavailable("later"), ChildDied()])
def test_trouble_is_not_remembered(trouble: Exception) -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        process.answers.put_nowait(trouble)
        with pytest.raises(Unavailable):
            await pool.check(request("a"), "x")
        process.answers.put_nowait({"spec": 1})
        assert await pool.check(request("a"), "x") == {"spec": 1}

    run(test)


def test_a_request_that_needs_too_much_memory_is_refused_for_its_scene_and_not_tried_again() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        process.answers.put_nowait(OutOfMemory("more memory than there is"))
        for _ in range(2):
            with pytest.raises(InvalidRequest, match=r"^scene: rendering it once takes more memory than there is; ask"):
                await pool.check(request("a"), "x")
        assert process.asked == ["a"]

    run(test)


def test_a_check_that_is_too_slow_is_left_to_the_worker_and_not_tried_again() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        process.answers.put_nowait(TooSlow())
        for _ in range(2):
            with pytest.raises(TooSlow):
                await pool.check(request("a"), "x")
        assert process.asked == ["a"]

    run(test)


def test_a_request_does_not_wait_behind_anothers_heavy_one() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        heavy = asyncio.ensure_future(pool.check(request("heavy"), "x"))
        await until_asked(process, 1)
        with pytest.raises(NoneFree):
            await pool.check(request("light"), "y")
        process.answers.put_nowait({"spec": 1})
        assert await heavy == {"spec": 1}
        assert process.asked == ["heavy"]  # the light one was dropped when it had been accepted

    run(test, wait=NOT_AT_ALL)


def test_a_client_does_not_wait_longer_than_a_check_may_take() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        with pytest.raises(TooSlow):
            await pool.check(request("a"), "x")
        process.answers.put_nowait({"spec": 1})
        answer = None
        async with asyncio.timeout(LONG):
            while answer is None:  # the process went on, and its answer is remembered
                with suppress(TooSlow):
                    answer = await pool.check(request("a"), "x")
                await asyncio.sleep(0)
        assert process.asked == ["a"]

    run(test, seconds=NOT_AT_ALL)


def test_a_request_whose_client_is_gone_is_not_checked() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        first = asyncio.ensure_future(pool.check(request("first"), "x"))
        await until_asked(process, 1)
        gone, kept = (asyncio.ensure_future(pool.check(request(name), "y")) for name in ("gone", "kept"))
        await asyncio.sleep(0)
        gone.cancel()
        await asyncio.wait([gone])
        for _ in range(2):
            process.answers.put_nowait({})
        await asyncio.gather(first, kept)
        assert process.asked == ["first", "kept"]

    run(test)


def test_clients_take_turns() -> None:
    async def test(pool: CheckPool, process: ToldProcess) -> None:
        checks = [asyncio.ensure_future(pool.check(request("x0"), "x"))]
        await until_asked(process, 1)
        for name in ("x1", "x2", "y0"):
            checks.append(asyncio.ensure_future(pool.check(request(name), name[0])))
            await asyncio.sleep(0)
        for _ in checks:
            process.answers.put_nowait({})
        await asyncio.gather(*checks)
        assert process.asked == ["x0", "y0", "x1", "x2"]

    run(test)
