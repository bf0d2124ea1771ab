"""Follows jobs in the record while workers run them, for the event streams of this process.

A stream reads what happened before it began by itself. What follows is read once, however many streams wait for it. A
stream ends with the key of its client.
"""

import asyncio
import time
from collections import Counter, deque
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from scene_attack.logs import logger
from scene_attack_service.access.keys import AccessKeys
from scene_attack_service.jobs.jobs import News
from scene_attack_service.jobs.models import Event, Job
from scene_attack_service.jobs.record import Record

KEY_SECONDS = 2.0
"""Time between two looks at whether the keys are still valid."""


class StreamKeys:
    """Counts the streams of each key. Used by one event loop."""

    def __init__(self, keys: AccessKeys) -> None:
        self._keys = keys
        self._streams: Counter[str] = Counter()
        """The prefixes of the streams' keys, each with the number of its streams."""
        self._ended: set[str] = set()
        """Prefixes of the streams' keys that have ended."""
        self._looked = float("-inf")

    @contextmanager
    def waiting(self, key: str) -> Iterator[None]:
        """Counts a stream of the key with this prefix ("": of a service without keys) while it is entered."""
        self._streams[key] += 1
        try:
            yield
        finally:
            self._streams[key] -= 1
            if not self._streams[key]:
                del self._streams[key]
                self._ended.discard(key)

    def ended(self, key: str | None) -> bool:
        """Whether a key was seen to have ended."""
        return key in self._ended

    async def look(self) -> bool:
        """Asks the record, if it was not asked in the last KEY_SECONDS. Returns whether a key has ended."""
        asked = set(self._streams)
        if not asked or time.monotonic() - self._looked < KEY_SECONDS:
            return False
        self._looked = time.monotonic()
        try:
            ended = await run_in_threadpool(self._keys.ended, asked)
        except SQLAlchemyError as error:
            log.warning("keys of streams not checked", error=str(error))
            return False
        self._ended |= ended & set(self._streams)
        return bool(ended)


POLL_SECONDS = 0.2
"""Time between two reads of the record."""
KEPT = 64
"""Number of a job's last events that are kept for its streams; one that falls further behind reads the record."""
READ = 8
"""Events that a stream reads from the record at a time: each of hundreds of streams holds what it has read."""

log = logger(__name__)


@dataclass(eq=False)
class _Followed:
    """A job that streams wait for: its last events, the number of the last one, and whether it has ended."""

    last: int
    ended: bool = False
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=KEPT))
    streams: int = 0
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def add(self, news: News) -> None:
        """Adds what is new and wakes the streams."""
        if news.events:
            self.events.extend(news.events)
            self.last = news.events[-1].number
        self.ended = news.ended
        self.wake()

    def wake(self) -> None:
        """Wakes the streams."""
        heard, self.news = self.news, asyncio.Event()
        heard.set()

    def after(self, number: int) -> list[Event] | None:
        """The events with a number above `number` up to the last, or None if some of them are not kept."""
        if number >= self.last:
            return []
        if not self.events or self.events[0].number > number + 1 or self.events[-1].number < self.last:
            return None
        return [event for event in self.events if event.number > number]


class Watcher:
    """Reads the events of followed jobs, and whether the keys of those who follow them are still valid. Its task runs
    while there are any.
    """

    def __init__(self, record: Record, keys: AccessKeys) -> None:
        self._record = record
        self._keys = StreamKeys(keys)
        self._followed: dict[str, _Followed] = {}
        self._task: asyncio.Task[None] | None = None

    def streams(self) -> int:
        """The number of streams that wait now."""
        return sum(followed.streams for followed in self._followed.values())

    def close(self) -> None:
        """Stops reading."""
        if self._task is not None:
            self._task.cancel()

    async def events(self, job: Job, after: int, key: str | None = None) -> AsyncGenerator[Event, None]:
        """Yields the job's events with a number above `after` as they are recorded, until the job has ended, or the key
        with the prefix `key` if one is given ("": until there is a key).
        """
        with self._following(job) as followed, nullcontext() if key is None else self._keys.waiting(key):
            while not self._keys.ended(key):
                if after >= followed.last:
                    if followed.ended:
                        return
                    await followed.news.wait()
                    continue
                events = followed.after(after)
                if events is None:
                    events = await run_in_threadpool(self._record.jobs.events, job.id, after, READ)
                    if not events:
                        return  # the job was deleted
                for event in events:
                    yield event
                    after = event.number

    async def ended_within(self, job_id: str, seconds: float) -> Job | None:
        """Waits for the end of a job, and returns it with its result; None if it takes more than `seconds`."""
        queued = await run_in_threadpool(self._record.jobs.line, job_id)
        if queued is None:
            return None
        try:
            async with asyncio.timeout(seconds), aclosing(self.events(queued, queued.events)) as events:
                async for _ in events:
                    pass  # only their end is of interest
        except TimeoutError:
            return None
        return await run_in_threadpool(partial(self._record.jobs.get, job_id, with_result=True))

    @contextmanager
    def _following(self, job: Job) -> Iterator[_Followed]:
        followed = self._followed.setdefault(job.id, _Followed(job.events))
        if job.state.terminal:  # nothing will follow, and what there is can be read
            followed.last, followed.ended = max(followed.last, job.events), True
        followed.streams += 1
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._watch())
        try:
            yield followed
        finally:
            followed.streams -= 1
            if not followed.streams:
                del self._followed[job.id]

    async def _watch(self) -> None:
        while self._followed:
            if await self._keys.look():
                for followed in self._followed.values():
                    followed.wake()
            seen = {job_id: followed.last for job_id, followed in self._followed.items() if not followed.ended}
            try:
                news = await run_in_threadpool(self._record.jobs.news, seen)
            except SQLAlchemyError as error:
                log.warning("events not read, the streams wait", error=str(error))
            else:
                for job_id, latest in news.items():
                    if job_id in self._followed:
                        self._followed[job_id].add(latest)
            await asyncio.sleep(POLL_SECONDS)
