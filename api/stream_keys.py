"""The keys with which clients wait for streams of this process, and which of them have ended."""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from services.access.keys import AccessKeys
from services.logs import logger

KEY_SECONDS = 2.0
"""Time between two looks at whether the keys are still valid."""

log = logger(__name__)


class StreamKeys:
    """Counts the streams of each key. Used by one event loop."""

    def __init__(self, keys: AccessKeys) -> None:
        self._keys = keys
        self._streams: Counter[str] = Counter()
        """The prefixes of the streams' keys, each with the number of its streams."""
        self._ended: set[str] = set()
        """Those of them that have ended."""
        self._looked = float("-inf")

    def __bool__(self) -> bool:
        """Whether there are streams."""
        return bool(self._streams)

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
