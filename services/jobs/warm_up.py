"""Start-up of every process that renders and classifies. It is the same for all, so that their images agree, and others
than job processes go first where processor time is short.
"""

import os
import resource
from contextlib import suppress
from pathlib import Path

import torch

from services.confinement import forbid_new_privileges
from services.jobs.child import limit_memory
from services.pipeline.extensions import log_extensions, set_up
from services.pipeline.spec import DEFAULT_TARGET
from services.rendering.opengl.context import gl_backend
from services.settings import Settings
from services.targets import registry

NICENESS = 10
"""Niceness of job processes. One of niceness 0 gets about nine times as much processor time: the API still answers."""
CHECKING = 5
"""Niceness of the processes that check and preview requests: before jobs, and after the API."""
AUTOGROUP = Path("/proc/self/autogroup")


def warm_up(values: Settings) -> str:
    """Sets up the process, limits its memory, forbids new privileges and core files, sets torch's threads, loads the
    default network and opens the OpenGL context.

    Returns the name of the OpenGL backend.
    """
    set_up(values)
    limit_memory(values)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    forbid_new_privileges()
    torch.set_num_threads(values.threads)
    log_extensions()
    registry.load(DEFAULT_TARGET)
    return gl_backend()


def give_way(niceness: int = NICENESS) -> None:
    """Lets processes of ordinary niceness go first, from now on. Alone on the machine, this one runs as fast as before.

    Linux may share the processor between sessions first (autogroups), so that the niceness of the session counts.
    """
    os.nice(niceness)
    with suppress(OSError):  # a kernel without autogroups
        AUTOGROUP.write_text(str(niceness))
