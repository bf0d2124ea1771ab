"""Start-up of every process that renders and classifies. It is the same for all, so that their images agree."""

import resource

import torch

from services.pipeline.extensions import log_extensions
from services.pipeline.spec import DEFAULT_TARGET
from services.rendering.opengl.context import gl_backend
from services.settings import Settings
from services.targets import registry


def warm_up(values: Settings) -> str:
    """Limits the memory, sets torch's threads, loads the default network and opens the OpenGL context.

    Returns the name of the OpenGL backend.
    """
    resource.setrlimit(resource.RLIMIT_AS, (values.job_memory_bytes, values.job_memory_bytes))
    torch.set_num_threads(values.threads)
    log_extensions()
    registry.load(DEFAULT_TARGET)
    return gl_backend()
