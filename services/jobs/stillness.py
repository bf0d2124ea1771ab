"""Notices a process that hangs. One that is stopped or deadlocked, or waits for an answer that never comes, uses no
processor time; a computation does, however long it takes.
"""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

LOOK_SECONDS = 1.0
"""Shortest time between two looks."""
LONGEST_GAP = 2.0
"""Time between two looks beyond which it was the caller that stood still, or the machine that slept."""
SIGN_SECONDS = 0.05
"""Processor time that is a sign of life. A process that polls every second uses less in the time allowed."""
_TICKS = os.sysconf("SC_CLK_TCK")


class Stillness:
    """How long the processes of a session have done nothing. `session` is the process id of its leader."""

    def __init__(self, session: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._session = session
        self._clock = clock
        self._looked = clock()
        self._used = processor_seconds(session)
        self._still = 0.0

    def seconds(self) -> float:
        """The time in seconds since the last sign of life, as far as the caller was awake to see it pass."""
        now = self._clock()
        gap = now - self._looked
        if gap >= LOOK_SECONDS:
            self._looked = now
            used = processor_seconds(self._session)
            if abs(used - self._used) >= SIGN_SECONDS:
                self._used, self._still = used, 0.0
            else:
                self._still += min(gap, LONGEST_GAP)
        return self._still


def processor_seconds(session: int) -> float:
    """Processor time in seconds that the living processes of a session, and those they waited for, have used."""
    ticks = 0
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            with suppress(OSError):  # it has ended meanwhile
                fields = Path(entry.path, "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == session:
                    ticks += sum(int(value) for value in fields[11:15])
    return ticks / _TICKS
