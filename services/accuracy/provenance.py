"""What made a report: the packages it depends on, and the backend."""

import torch

from services.rendering.kernels import compiled
from services.rendering.opengl.context import gl_backend

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
    return f"torch cpu, {torch.get_num_threads()} threads, shading {compiled.backend()}; {gl_backend()}"
