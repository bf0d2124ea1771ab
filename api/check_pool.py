"""A bounded pool of warm processes that check or preview requests, in which one client's cannot hold up another's.

A check waits and runs for a limited time. Equal checks share one, and what was found is remembered for a while.
"""

import asyncio
import time
from collections import OrderedDict
from collections.abc import Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Protocol

from api.fair_queue import FairQueue, Place
from api.warm_process import START_SECONDS, TooSlow, Unavailable
from services.errors import InvalidFields, InvalidRequest
from services.jobs.child import ChildDied, OutOfMemory

REMEMBERED = 1000
"""Number of checks whose answer is remembered, unless a pool says otherwise."""
REMEMBER_SECONDS = 600.0
"""Time after which a remembered check is made again, since networks and files may have changed."""


class NoneFree(Exception):
    """No process was free in time."""


class Process(Protocol):
    """What the pool needs of `WarmProcess`."""

    async def start(self) -> None: ...  # noqa: D102
    async def ask(self, message: dict[str, Any], file: BinaryIO | None, seconds: float) -> dict[str, Any]: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


@dataclass(frozen=True)
class Request:
    """What to check: the message to a process, its cost compared with others', and a key that equal ones share."""

    key: str
    message: dict[str, Any]
    cost: float


@dataclass(frozen=True)
class _Known:
    """What a process said at a time; TooSlow if it did not in time, as it would not again."""

    at: float
    answer: dict[str, Any] | InvalidRequest | TooSlow


@dataclass(eq=False)
class _Check:
    """A check that waits or runs, and the number of clients that wait for it."""

    request: Request
    started: asyncio.Event = field(default_factory=asyncio.Event)
    answer: "asyncio.Future[dict[str, Any] | InvalidRequest | Unavailable | TooSlow]" = field(
        default_factory=lambda: asyncio.get_running_loop().create_future()
    )
    waiting: int = 0


class CheckPool:
    """The processes, and the checks that wait for them. A check waits for `wait_seconds` and runs for `seconds`."""

    def __init__(
        self, processes: Sequence[Process], wait_seconds: float, seconds: float, remembered: int = REMEMBERED
    ) -> None:
        self._processes = processes
        self.wait_seconds = wait_seconds
        self.seconds = seconds
        self.remembered = remembered
        self._idle: list[Process] = []
        self._queue: FairQueue[_Check] = FairQueue()
        self._open: dict[str, tuple[_Check, Place[_Check]]] = {}
        self._known: OrderedDict[str, _Known] = OrderedDict()
        self._tasks: set[asyncio.Task[None]] = set()
        self._ready = asyncio.Event()

    def start(self) -> None:
        """Starts the processes, without waiting until they are warm."""
        for process in self._processes:
            self._in_background(self._join(process))

    def close(self) -> None:
        """Ends the processes; waiting requests are dropped."""
        for task in self._tasks:
            task.cancel()
        for process in self._processes:
            process.close()

    async def check(self, request: Request, client: str) -> dict[str, Any]:
        """Returns a process's answer. Raises InvalidRequest, NoneFree, TooSlow, and Unavailable."""
        known = self._known.get(request.key)
        if known is not None and time.monotonic() - known.at < REMEMBER_SECONDS:
            return _said(known.answer)
        if not self._ready.is_set():
            await self._first_process()
        check, place = self._open.get(request.key) or self._added(request, client)
        check.waiting += 1
        try:
            if not check.started.is_set():
                await asyncio.wait_for(check.started.wait(), self.wait_seconds)
            # A process that has to be started again first would take longer than the check may.
            return _said(await asyncio.wait_for(asyncio.shield(check.answer), self.seconds))
        except TimeoutError as error:
            raise TooSlow if check.started.is_set() else NoneFree from error
        finally:
            check.waiting -= 1
            if not check.waiting and self._queue.drop(place):
                del self._open[request.key]

    def _added(self, request: Request, client: str) -> tuple[_Check, Place[_Check]]:
        check = _Check(request)
        found = self._open[request.key] = check, self._queue.add(check, client, request.cost)
        self._serve()
        return found

    async def _first_process(self) -> None:
        """Waits for a process after the service has started. Afterwards checks do not wait for one to start again."""
        try:
            await asyncio.wait_for(self._ready.wait(), START_SECONDS)
        except TimeoutError as error:
            raise Unavailable("the processes that check requests do not start; the service's log says why") from error

    async def _join(self, process: Process) -> None:
        with suppress(Unavailable):  # the next check tries again, and says if it cannot
            await process.start()
        self._ready.set()
        self._idle.append(process)
        self._serve()

    def _serve(self) -> None:
        while self._idle and len(self._queue):
            place = self._queue.take()
            place.what.started.set()
            self._in_background(self._run(self._idle.pop(), place))

    async def _run(self, process: Process, place: Place[_Check]) -> None:
        check = place.what
        answer: dict[str, Any] | InvalidRequest | Unavailable | TooSlow
        try:
            answer = await process.ask(check.request.message, None, self.seconds)
        except ChildDied:
            answer = Unavailable("the check of this request was cut short; try again")
        except OutOfMemory as error:
            smaller = "ask for a smaller image, a smaller environment map or fewer objects"
            answer = InvalidRequest("scene", f"rendering it once takes {error}; {smaller}")
        except (InvalidRequest, Unavailable, TooSlow) as error:
            answer = error
        if not isinstance(answer, Unavailable):
            self._remember(check.request.key, answer)
        del self._open[check.request.key]
        self._queue.done(place)
        check.answer.set_result(answer)
        self._idle.append(process)
        self._serve()

    def _remember(self, key: str, answer: dict[str, Any] | InvalidRequest | TooSlow) -> None:
        self._known[key] = _Known(time.monotonic(), answer)
        self._known.move_to_end(key)
        while len(self._known) > self.remembered:
            self._known.popitem(last=False)

    def _in_background(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _said(answer: dict[str, Any] | InvalidRequest | Unavailable | TooSlow) -> dict[str, Any]:
    if isinstance(answer, InvalidRequest):  # a new one for each client: a remembered one would collect tracebacks
        raise InvalidFields(answer.every)
    if isinstance(answer, TooSlow):
        raise TooSlow
    if isinstance(answer, Unavailable):
        raise answer
    return answer
