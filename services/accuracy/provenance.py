"""What made a report: the packages it depends on, and the backend."""

import torch

from services.rendering import native
from services.rendering.gl import gl_backend

PACKAGES = (
    "scene-attack",
    "torch",
    "numpy",
    "scipy",
    "pyrender-maintained",
    "PyOpenGL",
    "trimesh",
    "OpenEXR",
)


def backend() -> str:
    """What renders and sums in this process."""
    return f"torch cpu, {torch.get_num_threads()} threads, shading {native.backend()}; {gl_backend()}"
