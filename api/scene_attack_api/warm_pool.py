"""Two warm processes that check and preview requests and make exports, so that the API itself uses neither OpenGL nor
torch.

Previews and exports hold at most one of them, so that no check waits for either. The first process starts with the
service, the second one with the first preview or export.
"""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from tempfile import mkstemp
from typing import Any

from fastapi import HTTPException

from scene_attack.errors import InvalidFields, InvalidRequest, QuotaExceeded
from scene_attack.export import ASSET
from scene_attack.logs import logger
from scene_attack_service.jobs.processes import Child, ChildDied, OutOfMemory
from scene_attack_service.settings import Settings

PROGRAM = "scene_attack_service.jobs.warm_process"
START_SECONDS = 180.0
"""Longest time that a process may take to load."""
MOST_OPEN = 16
"""Previews and exports of one client that may be open at the same time."""
RETRY_SECONDS = 5.0
"""Time after which a client that has too many open may try again."""

Answer = dict[str, Any]
log = logger(__name__)


class Unavailable(Exception):
    """The request could not be answered now; the client may try again."""


class TooSlow(Exception):
    """The process had not answered in time, and was killed."""


class NoneFree(Exception):
    """No process was free in time."""


class WarmProcess:
    """A child that stays warm between requests. It answers one at a time, and is started again when it has died."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._child: Child | None = None
        self._thread = ThreadPoolExecutor(1, "warm-process")

    async def start(self) -> None:
        """Starts the process and waits until it is warm. Raises Unavailable if it does not start."""
        await asyncio.get_running_loop().run_in_executor(self._thread, self._warm)

    def alive(self) -> bool:
        """Whether the process runs."""
        return self._child is not None and self._child.alive()

    def close(self) -> None:
        """Ends the process; a request in progress gets ChildDied."""
        child = self._child
        if child is not None:
            child.end()
        self._thread.shutdown(cancel_futures=True)
        if self._child is not None:
            self._child.kill()
            self._child = None

    async def ask(self, message: dict[str, Any], seconds: float) -> Answer:
        """Returns the answer to a request, which may take `seconds` once the process is warm.

        Raises InvalidRequest for an invalid field, TooSlow, OutOfMemory, ChildDied if the process ended, and
        Unavailable.
        """
        answer = await asyncio.get_running_loop().run_in_executor(self._thread, self._ask, message, seconds)
        if "errors" in answer:
            raise InvalidFields([InvalidRequest(*pair) for pair in answer["errors"]])
        if "trouble" in answer:
            raise Unavailable(f"the request failed: {answer['trouble']}")
        return answer

    def _ask(self, message: dict[str, Any], seconds: float) -> Answer:
        child = self._warm()
        try:
            child.send(message)
            answer = self._answer(child, seconds)
        except ChildDied:
            log.warning("warm process died", pid=child.pid)
            self._end(child)
            raise
        except OutOfMemory:
            log.warning("warm process needs too much memory", pid=child.pid)
            raise
        if answer is None:
            log.warning("warm process was too slow", pid=child.pid, seconds=seconds)
            self._end(child)
            raise TooSlow
        return answer

    def _warm(self) -> Child:
        if self._child is not None and self._child.alive():
            return self._child
        if self._child is not None:
            self._child.kill()
        child = self._child = Child(PROGRAM, self._settings)
        try:
            ready = self._answer(child, START_SECONDS)
        except (ChildDied, OutOfMemory):
            ready = None
        if ready is None:
            self._end(child)
            raise Unavailable("a process that checks requests does not start; the service's log says why")
        log.info("warm process ready", pid=child.pid)
        return child

    def _answer(self, child: Child, seconds: float) -> Answer | None:
        """The child's next answer, or None if it takes more than `seconds` or the child hangs.

        Raises ChildDied and OutOfMemory.
        """
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0 and child.idle_seconds() < self._settings.stall_seconds:
            answer = child.receive(min(left, 1.0))
            if answer is not None:
                return answer
        return None

    def _end(self, child: Child) -> None:
        child.kill()
        self._child = None


@dataclass
class _Line:
    """The requests of a client: those that may go on, and the number of all that are open."""

    turn: asyncio.Semaphore
    open: int = 0


class Turns:
    """Lets at most `at_once` requests of each client go on, so that however many it sends, others wait for no more of
    them. The others of its own wait; those beyond `most` are refused.
    """

    def __init__(self, at_once: int, most: int) -> None:
        self._at_once = at_once
        self._most = most
        self._lines: dict[str, _Line] = {}

    @asynccontextmanager
    async def turn(self, client: str) -> AsyncIterator[None]:
        """Waits until a request of the client may go on, which it does while this is entered. Raises QuotaExceeded."""
        line = self._lines.setdefault(client, _Line(asyncio.Semaphore(self._at_once)))
        if line.open >= self._most:
            raise QuotaExceeded(f"{self._most} such requests of yours are open already", RETRY_SECONDS)
        line.open += 1
        try:
            async with line.turn:
                yield
        finally:
            line.open -= 1
            if not line.open:
                del self._lines[client]


class WarmPool:
    """The two processes, and the requests that wait for them, in the order in which they came."""

    def __init__(self, processes: Sequence[WarmProcess]) -> None:
        self._processes = processes
        self._started = 0
        self._up = [asyncio.Event() for _ in processes]
        self._idle: asyncio.Queue[WarmProcess] = asyncio.Queue()
        self._long = asyncio.Lock()
        self._turns = Turns(1, MOST_OPEN)
        self._tasks: set[asyncio.Task[Any]] = set()

    def start(self, number: int = 1) -> None:
        """Starts the first `number` processes, those that are not started yet, without waiting until they are warm."""
        for k in range(self._started, number):
            self._in_background(self._join(self._processes[k], self._up[k]))
        self._started = max(self._started, number)

    def close(self) -> None:
        """Ends the processes; waiting requests are dropped."""
        for task in self._tasks:
            task.cancel()
        for process in self._processes:
            process.close()

    async def check(self, message: dict[str, Any], wait: float, seconds: float) -> Answer:
        """Returns the answer to a short request, which may wait for `wait` seconds and take `seconds`.

        Raises NoneFree, TooSlow, InvalidRequest, OutOfMemory, ChildDied and Unavailable.
        """
        await self._until_up(1)
        try:
            async with asyncio.timeout(wait):
                process = await self._free()
        except TimeoutError as error:
            raise NoneFree from error
        return await self._run(process, message, seconds)

    async def work(self, message: dict[str, Any], client: str, wait: float, seconds: float) -> Answer:
        """Returns the answer to a preview or an export of a client, as `check` does, one at a time.

        Raises QuotaExceeded, too, if the client has too many open.
        """
        self.start(len(self._processes))
        await self._until_up(len(self._processes))
        try:
            async with asyncio.timeout(wait) as patience, self._turns.turn(client):
                await self._long.acquire()
                try:
                    process = await self._free()
                except BaseException:
                    self._long.release()
                    raise
                patience.reschedule(None)
                return await self._run(process, message, seconds, self._long.release)
        except TimeoutError as error:
            raise NoneFree from error

    async def _until_up(self, number: int) -> None:
        """Waits for processes after the service has started. Later no request waits for one to start again."""
        try:
            async with asyncio.timeout(START_SECONDS):
                for up in self._up[:number]:
                    await up.wait()
        except TimeoutError as error:
            raise Unavailable("the processes that check requests do not start; the service's log says why") from error

    async def _free(self) -> WarmProcess:
        """An idle process. One that has died meanwhile is started again, and this waits for that one or another."""
        while True:
            process = self._idle.get_nowait() if not self._idle.empty() else await self._idle.get()
            if process.alive():
                return process
            self._in_background(self._join(process))

    async def _run(
        self, process: WarmProcess, message: dict[str, Any], seconds: float, done: Callable[[], None] | None = None
    ) -> Answer:
        """Returns a process's answer. It works to the end if this is cancelled: starting it again would take longer."""

        async def run() -> Answer:
            try:
                return await process.ask(message, seconds)
            finally:
                if done is not None:
                    done()
                if process.alive():
                    self._idle.put_nowait(process)
                else:
                    self._in_background(self._join(process))

        return await asyncio.shield(self._in_background(run()))

    async def _join(self, process: WarmProcess, up: asyncio.Event | None = None) -> None:
        with suppress(Unavailable):  # the next request tries again, and says if it cannot
            await process.start()
        self._idle.put_nowait(process)
        if up is not None:
            up.set()

    def _in_background(self, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._forget)
        return task

    def _forget(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled():
            task.exception()  # the client that waited for it may have gone


EXPORT_SECONDS = 120.0
"""Longest time for one export, and longest wait for those before it."""


class Exporter:
    """Makes exports of jobs and glTF files of assets, one at a time and together with previews."""

    def __init__(self, pool: WarmPool) -> None:
        self._pool = pool

    async def made(self, what: str, job_id: str, artifacts: Mapping[str, str], client: str) -> BufferedReader:
        """The open file of an export, which has no name any more: all of it (`BUNDLE`), or the scene "before" or
        "after".

        `artifacts` are the SHA-256 of the job's files by name. Raises Unavailable, and HTTPException(409) for a job
        that cannot be exported.
        """
        message = {"what": what, "job": job_id, "artifacts": dict(artifacts)}
        return await self._file(message, client, "job cannot be exported")

    async def asset(self, mesh: str, client: str) -> BufferedReader:
        """The open glTF file of the scene of one mesh. Raises as `made` does."""
        return await self._file({"what": ASSET, "mesh": mesh}, client, "asset cannot be shown")

    async def _file(self, message: dict[str, Any], client: str, refusal: str) -> BufferedReader:
        handle, path = mkstemp(prefix="scene-attack-export-")
        os.close(handle)
        try:
            export = {"export": message | {"out": path}}
            answer = await self._pool.work(export, client, EXPORT_SECONDS, EXPORT_SECONDS)
            if "refused" in answer:
                raise HTTPException(409, f"the {refusal}: {answer['refused']}")
            return Path(path).open("rb")
        except NoneFree as error:
            raise Unavailable("other exports take too long; try again") from error
        except OutOfMemory as error:
            raise Unavailable(f"the export failed: it needs {error}") from error
        except (ChildDied, TooSlow) as error:
            detail = f"the export did not end within {EXPORT_SECONDS:g} seconds and the memory allowed"
            raise Unavailable(detail) from error
        finally:
            os.unlink(path)
