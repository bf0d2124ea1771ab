"""The pool with processes that answer when the test says so, so that nothing depends on the machine's speed."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from scene_attack.errors import InvalidRequest, QuotaExceeded
from scene_attack.strict import Names
from scene_attack_api.submissions import Checks
from scene_attack_api.warm_pool import MOST_OPEN, NoneFree, TooSlow, Unavailable, WarmPool
from scene_attack_service.access.caller import KEYLESS
from scene_attack_service.jobs.processes import ChildDied, OutOfMemory
from scene_attack_service.settings import Settings
from tests.unit.jobs.small import spec

LONG, NOT_AT_ALL = 60.0, 0.0


class Told:
    """What two processes were asked, in order, and what they answer next."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.started: list[int] = []
        self.answers: asyncio.Queue[dict[str, Any] | Exception] = asyncio.Queue()

    async def until_asked(self, count: int) -> None:
        async with asyncio.timeout(LONG):
            while len(self.asked) < count:
                await asyncio.sleep(0)


class ToldProcess:
    """Answers each request with what the test puts into `answers`; it is dead after ChildDied."""

    def __init__(self, number: int, told: Told) -> None:
        self.number = number
        self.told = told
        self.lives = True

    async def start(self) -> None:
        self.told.started.append(self.number)
        self.lives = True

    async def ask(self, message: dict[str, Any], seconds: float) -> dict[str, Any]:
        self.told.asked.append(message.get("name", ""))
        answer = await self.told.answers.get()
        self.lives = not isinstance(answer, ChildDied)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def alive(self) -> bool:
        return self.lives

    def close(self) -> None:
        pass


def run(test: Callable[[WarmPool, Told], Awaitable[None]]) -> None:
    async def inside() -> None:
        told = Told()
        pool = WarmPool([ToldProcess(number, told) for number in range(2)])
        pool.start()
        await test(pool, told)
        pool.close()

    asyncio.run(inside())


def work(pool: WarmPool, name: str, client: str = "x", wait: float = LONG) -> "asyncio.Task[dict[str, Any]]":
    return asyncio.ensure_future(pool.work({"name": name}, client, wait, LONG))


async def check(pool: WarmPool, name: str = "check", wait: float = LONG) -> dict[str, Any]:
    return await pool.check({"name": name}, wait, LONG)


def test_one_process_is_enough_for_checks() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        told.answers.put_nowait({"spec": 1})
        assert await check(pool) == {"spec": 1}
        assert told.started == [0]

    run(test)


def test_previews_and_exports_hold_one_process_and_checks_have_the_other() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        first, second = work(pool, "preview", "x"), work(pool, "export", "y")
        await told.until_asked(1)
        checking = asyncio.ensure_future(check(pool))
        await told.until_asked(2)
        assert told.asked == ["preview", "check"]
        assert sorted(told.started) == [0, 1]
        for _ in range(3):
            told.answers.put_nowait({})
        await asyncio.gather(first, second, checking)
        assert told.asked == ["preview", "check", "export"]

    run(test)


def test_a_check_that_gets_no_process_in_time_does_not_wait() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        heavy = asyncio.ensure_future(check(pool, "heavy"))
        await told.until_asked(1)
        with pytest.raises(NoneFree):
            await check(pool, "light", NOT_AT_ALL)
        told.answers.put_nowait({"spec": 1})
        assert await heavy == {"spec": 1}
        assert told.asked == ["heavy"]

    run(test)


def test_a_preview_waits_for_others_for_a_limited_time() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        first = work(pool, "first", "x")
        await told.until_asked(1)
        with pytest.raises(NoneFree):
            await work(pool, "second", "y", NOT_AT_ALL)
        told.answers.put_nowait({})
        await first
        assert told.asked == ["first"]

    run(test)


def test_clients_take_turns_however_many_previews_one_of_them_sends() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        asked = [work(pool, "x0", "x")]
        await told.until_asked(1)
        for name in ("x1", "x2", "y0"):
            asked.append(work(pool, name, name[0]))
            await asyncio.sleep(0)
        for _ in asked:
            told.answers.put_nowait({})
        await asyncio.gather(*asked)
        assert told.asked == ["x0", "y0", "x1", "x2"]

    run(test)


def test_a_client_with_too_many_previews_is_refused_and_others_are_not() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        asked = [work(pool, "x", "x") for _ in range(MOST_OPEN)]
        await told.until_asked(1)
        with pytest.raises(QuotaExceeded, match=f"{MOST_OPEN} such requests"):
            await work(pool, "one more", "x")
        asked.append(work(pool, "y", "y"))
        for _ in asked:
            told.answers.put_nowait({})
        await asyncio.gather(*asked)
        assert told.asked[:2] == ["x", "y"]

    run(test)


def test_a_request_whose_client_is_gone_is_not_made_and_one_in_progress_holds_its_process_to_its_end() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        first = work(pool, "first", "x")
        await told.until_asked(1)
        waiting, kept = work(pool, "waiting", "y"), work(pool, "kept", "z")
        await asyncio.sleep(0)
        for gone in (first, waiting):
            gone.cancel()
            await asyncio.wait([gone])
        assert told.asked == ["first"]
        for _ in range(2):
            told.answers.put_nowait({})
        await kept
        assert told.asked == ["first", "kept"]

    run(test)


def test_a_process_that_died_is_started_again_before_it_is_asked() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        told.answers.put_nowait(ChildDied())
        with pytest.raises(ChildDied):
            await check(pool)
        told.answers.put_nowait({"spec": 1})
        assert await check(pool) == {"spec": 1}
        assert told.started == [0, 0]

    run(test)


def no_names(_: object) -> Names:
    return {}


def checks(pool: WarmPool) -> Checks:
    return Checks(pool, no_names, Settings(check_seconds=LONG))


def test_a_request_that_needs_too_much_memory_is_refused_for_its_scene() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        told.answers.put_nowait(OutOfMemory("more memory than there is"))
        with pytest.raises(InvalidRequest, match=r"^scene: rendering it once takes more memory than there is; ask"):
            await checks(pool).check(spec(), KEYLESS)

    run(test)


def test_a_check_that_died_may_be_tried_again() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        told.answers.put_nowait(ChildDied())
        with pytest.raises(Unavailable, match="cut short"):
            await checks(pool).check(spec(), KEYLESS)

    run(test)


def test_a_check_that_is_too_slow_is_left_to_the_worker_and_not_tried_again() -> None:
    async def test(pool: WarmPool, told: Told) -> None:
        tried = checks(pool)
        told.answers.put_nowait(TooSlow())
        for seed in range(2):
            assert await tried.check(spec(seed=seed), KEYLESS) is None
        assert len(told.asked) == 1

    run(test)
