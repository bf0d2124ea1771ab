"""Whether the data directory can be written, found out by writing to it."""

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

FREE_BYTES = 16 * 2**20
"""Free space below which the disk is full: the files of a job take a few megabytes."""
REMEMBER_SECONDS = 1.0
"""Time for which what was found is remembered."""
_PROBE = bytes(4096)


class Storage:
    """The data directory `folder`."""

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder = folder
        self._clock = clock
        self._found = False
        self._looked = float("-inf")

    def usable(self) -> bool:
        """Whether files can be written there, as of a second ago at most."""
        now = self._clock()
        if now - self._looked >= REMEMBER_SECONDS:
            self._found = _writable(self._folder)
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
