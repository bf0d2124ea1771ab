"""Whether what a job leaves can be kept: the data directory can be written, and the store of artifacts answers. And the
space that is set aside there, so that a job can be cancelled although the disk is full.
"""

import os
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from sqlalchemy.exc import SQLAlchemyError

from services.jobs.artifacts import ArtifactStore
from services.jobs.outages import DISK_FULL, outage_of

FREE_BYTES = 16 * 2**20
"""Free space below which the disk is full: the files of a job take a few megabytes."""
REMEMBER_SECONDS = 1.0
"""Time for which what was found is remembered."""
RESERVE = "reserve"
"""The file in the data directory whose space is given up when the disk is full."""
RESERVE_BYTES = 4 * 2**20
"""Its size. SQLite's log, to which the record of a cancelled job adds some tens of kilobytes, grows to 4 MB."""
_PROBE = bytes(4096)

T = TypeVar("T")


class Storage:
    """The data directory `folder`, and the store of artifacts if it is elsewhere."""

    def __init__(
        self, folder: Path, store: ArtifactStore | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder = folder
        self._store = store
        self._clock = clock
        self._found = False
        self._looked = float("-inf")

    def usable(self) -> bool:
        """Whether files can be written there and the store answers, as of a second ago at most."""
        now = self._clock()
        if now - self._looked >= REMEMBER_SECONDS:
            self._found = _writable(self._folder) and (self._store is None or self._store.answers())
            self._looked = self._clock()
        return self._found

    def keep_reserve(self) -> None:
        """Sets space aside where there is enough of it and none is set aside yet. Raises OSError."""
        reserve = self._folder / RESERVE
        if not reserve.exists() and self.usable():
            with reserve.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, RESERVE_BYTES)

    def even_if_full(self, write: Callable[[], T]) -> T:
        """Returns what a small transaction returns. Where the disk is too full for it, it gets the space set aside.

        Raises SQLAlchemyError.
        """
        try:
            return write()
        except SQLAlchemyError as error:
            if outage_of(error) != DISK_FULL:
                raise
            with suppress(OSError):
                (self._folder / RESERVE).unlink(missing_ok=True)
            return write()


def _writable(folder: Path) -> bool:
    try:
        space = os.statvfs(folder)
        if space.f_bavail * space.f_frsize < FREE_BYTES:
            return False
        with tempfile.TemporaryFile(dir=folder) as probe:  # it has no name, so nothing is left of it
            probe.write(_PROBE)
            probe.flush()
            os.fsync(probe.fileno())
    except OSError:
        return False
    return True
