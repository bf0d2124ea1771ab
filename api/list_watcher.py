"""Tells lists of jobs that something has changed: one task looks for all open lists of this process."""

import asyncio
from collections.abc import AsyncGenerator

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from api.stream_keys import StreamKeys
from services.access.caller import Caller
from services.access.keys import AccessKeys
from services.jobs.lists import JobLists
from services.logs import logger

POLL_SECONDS = 0.7
"""Time between two looks."""

log = logger(__name__)


class ListWatcher:
    """Looks at the jobs that have not ended while there are lists that wait for a change of them."""

    def __init__(self, lists: JobLists, keys: AccessKeys) -> None:
        self._lists = lists
        self._keys = StreamKeys(keys)
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
        with self._keys.waiting(caller.key):
            if self._task is None or self._task.done():
                self._marks = None
                self._task = asyncio.get_running_loop().create_task(self._watch())
            while not self._keys.ended(caller.key):
                mark = self._mark(caller.only)
                if mark is not None and mark != last:
                    last = mark
                    yield mark
                await self._looked.wait()

    def _mark(self, owner: str | None) -> str | None:
        if self._marks is None:
            return None
        return self._marks.get(owner, "") if owner is not None else str(sorted(self._marks.items()))

    async def _watch(self) -> None:
        while self._keys:
            await self._keys.look()
            try:
                self._marks = await run_in_threadpool(self._lists.marks)
            except SQLAlchemyError as error:
                log.warning("changes of lists not read", error=str(error))
            heard, self._looked = self._looked, asyncio.Event()
            heard.set()
            await asyncio.sleep(POLL_SECONDS)
