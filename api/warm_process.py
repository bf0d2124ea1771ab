"""A warm process of the API, which answers one request at a time and is started again when it has died."""

import asyncio
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, BinaryIO

from services.errors import InvalidFields, InvalidRequest
from services.jobs.child import Child, ChildDied, OutOfMemory
from services.logs import logger
from services.settings import Settings

START_SECONDS = 180.0
"""Longest time that the process may take to load."""

log = logger(__name__)


class Unavailable(Exception):
    """The request could not be answered now; the client may try again."""


class TooSlow(Exception):
    """The process had not answered in time, and was killed."""


@dataclass
class _Asked:
    """A request: whether the process has it, and whether nobody waits for the answer any more."""

    sent: bool = False
    dropped: bool = False


class WarmProcess:
    """A child that runs a module, `services.jobs.preflight_process` by default, and stays warm between requests."""

    def __init__(self, settings: Settings, module: str = "services.jobs.preflight_process") -> None:
        self._settings, self._module = settings, module
        self._child: Child | None = None
        # With one thread, requests wait for one another.
        self._thread = ThreadPoolExecutor(1, "preflight")

    async def start(self) -> None:
        """Starts the process and waits until it is warm. Raises Unavailable if it does not start."""
        await asyncio.get_running_loop().run_in_executor(self._thread, self._warm)

    def close(self) -> None:
        """Ends the process; requests that wait for it are dropped."""
        child = self._child
        if child is not None:
            child.end()  # a request in progress gets ChildDied
        self._thread.shutdown(cancel_futures=True)
        if self._child is not None:
            self._child.kill()
            self._child = None

    async def ask(self, message: dict[str, Any], file: BinaryIO | None, seconds: float) -> dict[str, Any]:
        """Returns the answer to a request with the bytes of `file`, which may take `seconds` once the process is warm.

        Raises InvalidRequest for an invalid field, TooSlow, OutOfMemory, ChildDied if the process ended, and
        Unavailable. If this is cancelled, the process ends once it has the request: the next one need not wait for an
        answer nobody wants.
        """
        loop = asyncio.get_running_loop()
        asked = _Asked()
        try:
            answer = await loop.run_in_executor(self._thread, self._ask, message, file, seconds, asked)
        except asyncio.CancelledError:
            asked.dropped = True
            if asked.sent and self._child is not None:
                self._child.end()
            raise
        if "errors" in answer:
            raise InvalidFields([InvalidRequest(*one) for one in answer["errors"]])
        if "trouble" in answer:
            raise Unavailable(f"the check of this request failed: {answer['trouble']}")
        return answer

    def _ask(self, message: dict[str, Any], file: BinaryIO | None, seconds: float, asked: _Asked) -> dict[str, Any]:
        child = self._warm()
        asked.sent = True  # before the look at `dropped`, so that one of both threads sees what the other one did
        if asked.dropped:
            raise Unavailable("nobody waits for the answer")
        try:
            # Waiting uploads stay on the disk; only the file of this request is read into memory.
            child.send(message, b"" if file is None else file.read())
            answer = self._answer(child, seconds)
        except ChildDied:
            log.warning("preflight process died", pid=child.pid)
            self._end(child)
            raise
        except OutOfMemory:
            log.warning("preflight process needs too much memory", pid=child.pid)
            raise
        if answer is None:
            log.warning("preflight process was too slow", pid=child.pid, seconds=seconds)
            self._end(child)
            raise TooSlow
        return answer

    def _warm(self) -> Child:
        if self._child is not None and self._child.alive():
            return self._child
        if self._child is not None:
            self._child.kill()
        child = self._child = Child(self._module, self._settings)
        try:
            ready = self._answer(child, START_SECONDS)
        except (ChildDied, OutOfMemory):
            ready = None
        if ready is None:
            self._end(child)
            raise Unavailable(f"the process {self._module} does not start; the service's log says why")
        log.info("preflight process ready", pid=child.pid, module=self._module)
        return child

    def _answer(self, child: Child, seconds: float) -> dict[str, Any] | None:
        """The child's next answer, or None if it takes more than `seconds` or the child hangs.

        Raises ChildDied and OutOfMemory.
        """
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0 and child.still_seconds() < self._settings.stall_seconds:
            answer = child.receive(min(left, 1.0))
            if answer is not None:
                return answer
        return None

    def _end(self, child: Child) -> None:
        child.kill()
        self._child = None
