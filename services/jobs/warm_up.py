"""Start-up of every process that renders and classifies. It is the same for all, so that their images agree."""

import resource

import torch

from services.confinement.system_calls import forbid_new_privileges
from services.jobs.memory_limit import limit_memory
from services.pipeline.extensions import log_extensions, set_up
from services.pipeline.spec import DEFAULT_TARGET
from services.rendering.opengl.context import gl_backend
from services.settings import Settings
from services.targets import registry


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
