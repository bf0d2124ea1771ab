"""What every process that renders and asks networks does first; all of them alike, or their images might not be."""

import resource

import torch

from services.pipeline.extensions import log_extensions
from services.pipeline.spec import DEFAULT_TARGET
from services.rendering.opengl.context import gl_backend
from services.settings import Settings
from services.targets import registry


def warm_up(values: Settings) -> str:
    """Bound the memory, set torch's threads, load the default network, open the OpenGL context. Returns its backend."""
    resource.setrlimit(resource.RLIMIT_AS, (values.job_memory_bytes, values.job_memory_bytes))
    torch.set_num_threads(values.threads)
    log_extensions()
    registry.load(DEFAULT_TARGET)
    return gl_backend()
