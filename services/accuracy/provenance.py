"""The provenance of a report: the packages on which its figures depend, and the backend."""

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
    """The devices, kernels and OpenGL driver that render in this process, as one line of text."""
    return f"torch cpu, {torch.get_num_threads()} threads, shading {compiled.backend()}; {gl_backend()}"
