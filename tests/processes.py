"""What tests ask of other processes."""

from contextlib import suppress

import psutil


def command_line(process: psutil.Process) -> list[str]:
    """Its words, none once it has ended, even while its parent has not yet asked how."""
    with suppress(psutil.NoSuchProcess):
        return process.cmdline()
    return []
