"""What made a report: versions and backend."""

import platform
from importlib.metadata import version

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


def versions(*more: str) -> dict[str, str]:
    """Of Python and of the packages that results depend on, `more` among them."""
    return {"python": platform.python_version()} | {name: version(name) for name in (*PACKAGES, *more)}


def backend() -> str:
    """What renders and sums in this process."""
    return f"torch cpu, {torch.get_num_threads()} threads, shading {native.backend()}; {gl_backend()}"
