"""Tells lists of jobs that something has changed: one task looks for all open lists of this process."""

import asyncio
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from services.access.caller import Caller
from services.access.keys import AccessKeys
from services.jobs.lists import JobLists
from services.logs import logger

POLL_SECONDS = 0.7
"""Time between two looks."""
KEY_SECONDS = 2.0
"""Time between two looks at whether the keys of the lists are still valid."""

log = logger(__name__)
T = TypeVar("T")


class ListWatcher:
    """Looks at the jobs that have not ended while there are lists that wait for a change of them."""

    def __init__(self, lists: JobLists, keys: AccessKeys) -> None:
        self._lists = lists
        self._keys = keys
        self._callers: Counter[str] = Counter()
        self._ended: set[str] = set()
        self._marks: dict[str, str] | None = None
        """A text by owner that changes with the owner's jobs; None before the first look."""
        self._looked = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def close(self) -> None:
        """Stops looking."""
        if self._task is not None:
            self._task.cancel()

    async def changes(self, caller: Caller) -> AsyncGenerator[str, None]:
        """Yields a mark of the jobs that the caller sees, at first and whenever it has changed, until its key ends."""
        last = None
        with self._calling(caller.key):
            while caller.key not in self._ended:
                mark = self._mark(caller.only)
                if mark is not None and mark != last:
                    last = mark
                    yield mark
                await self._looked.wait()

    def _mark(self, owner: str | None) -> str | None:
        if self._marks is None:
            return None
        return self._marks.get(owner, "") if owner is not None else str(sorted(self._marks.items()))

    @contextmanager
    def _calling(self, key: str) -> Iterator[None]:
        self._callers[key] += 1
        if self._task is None or self._task.done():
            self._marks = None
            self._task = asyncio.get_running_loop().create_task(self._watch())
        try:
            yield
        finally:
            self._callers[key] -= 1
            if not self._callers[key]:
                del self._callers[key]
                self._ended.discard(key)

    async def _watch(self) -> None:
        keys_at = float("-inf")
        while self._callers:
            if time.monotonic() - keys_at >= KEY_SECONDS:
                keys_at, asked = time.monotonic(), set(self._callers)
                ended = await self._read(lambda: self._keys.ended(asked))  # noqa: B023 - it is called here
                self._ended |= (ended or set()) & set(self._callers)
            marks = await self._read(self._lists.marks)
            self._marks = self._marks if marks is None else marks
            heard, self._looked = self._looked, asyncio.Event()
            heard.set()
            await asyncio.sleep(POLL_SECONDS)

    async def _read(self, read: Callable[[], T]) -> T | None:
        try:
            return await run_in_threadpool(read)
        except SQLAlchemyError as error:
            log.warning("changes of lists not read", error=str(error))
            return None
