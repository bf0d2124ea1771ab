"""Whether what a job leaves can be kept: the data directory can be written, and the store of artifacts answers."""

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from services.jobs.artifacts import ArtifactStore

FREE_BYTES = 16 * 2**20
"""Free space below which the disk is full: the files of a job take a few megabytes."""
REMEMBER_SECONDS = 1.0
"""Time for which what was found is remembered."""
_PROBE = bytes(4096)


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
