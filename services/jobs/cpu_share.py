"""How much of the processor a process gets where others want it, too."""

import os
from contextlib import suppress
from pathlib import Path

NICENESS = 10
"""Of job processes: one of niceness 0 gets about nine times as much, so that the API answers while workers are busy."""
CHECKING = 5
"""Niceness of the processes that check and preview requests: before jobs, and after the API."""
AUTOGROUP = Path("/proc/self/autogroup")


def give_way(niceness: int = NICENESS) -> None:
    """Lets processes of ordinary niceness go first, from now on. Alone on the machine, this one runs as fast as before.

    Linux may share the processor between sessions first (autogroups), so that the niceness of the session counts.
    """
    os.nice(niceness)
    with suppress(OSError):  # a kernel without autogroups
        AUTOGROUP.write_text(str(niceness))
