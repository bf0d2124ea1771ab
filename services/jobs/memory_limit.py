"""The memory that a process which renders may have, so that all processes together fit the machine."""

import os
import resource
from pathlib import Path

from services.scenes.isolated_reading import READING_BYTES
from services.settings import Settings

WARM_PROCESSES = 2
"""Processes of the API that render (`api.warm_pool`)."""
REST_BYTES = 2 * 2**30
"""What the API, the workers, the supervisor, Redis and the system take."""
LEAST, MOST = 4 * 2**30, 16 * 2**30
"""Bounds of the default. A warm process has 1.1 GB of data (1.4 GB with PyTorch's CUDA build), and 2.0 GB (2.3 GB) with
an image of 1024×1024 pixels."""


def memory_limit(values: Settings) -> int:
    """Bytes of memory of a job process, and of each of the two that check and preview requests and make exports.

    The default is an equal share of the machine's memory, after READING_BYTES and REST_BYTES.
    """
    if values.job_memory_bytes is not None:
        return values.job_memory_bytes
    processes = values.workers + WARM_PROCESSES
    share = (machine_memory() - READING_BYTES - REST_BYTES) // processes
    return min(max(share, LEAST), MOST)


def limit_memory(values: Settings) -> None:
    """Lets every allocation of this process fail that takes its data beyond the limit.

    Data is what the process may write and shares with nobody. Address space would not do: PyTorch's CUDA build reserves
    gigabytes of it that it never uses. Shared memory is not counted; the parent looks at it (`Child`).
    """
    limit = memory_limit(values)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def more_than(limit: int) -> str:
    """The end of a sentence about a process that needs more than `limit` bytes, with the setting that limits it."""
    return f"more memory than SCENE_ATTACK_JOB_MEMORY_BYTES allows a process, {limit / 2**30:.3g} GiB"


def machine_memory(limit: Path = Path("/sys/fs/cgroup/memory.max")) -> int:
    """Bytes of the machine's memory, or of the container's `limit` if that is less."""
    physical = os.sysconf("SC_PHYS_PAGES") * resource.getpagesize()
    try:
        return min(physical, int(limit.read_text()))
    except (OSError, ValueError):  # there is no control group, or it has no limit ("max")
        return physical
