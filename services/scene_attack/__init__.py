"""Finds out how a vision model fails when the scene changes a little: its light, a surface, a colour, a pose.

import scene_attack as sa
"""

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scene_attack.client.client import AsyncClient, AsyncJob, Client, Job, images
    from scene_attack.client.errors import ApiError, Unfinished
    from scene_attack.in_process import attack

__all__ = ["ApiError", "AsyncClient", "AsyncJob", "Client", "Job", "Unfinished", "attack", "images"]

# OpenMP threads spin at every barrier by default. With more busy threads than cores, as beside other workers, that cost
# torch a factor of 10 to 30 (measured, 2 threads on 2 shared cores). Read when torch is loaded, so set here, before.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

_MODULES = {"ApiError": "client.errors", "Unfinished": "client.errors", "attack": "in_process"}
"""The module of each name; all others are in `client.client`."""


def __getattr__(name: str) -> Any:
    """Imports what is asked for: a command line that starts needs none of it."""
    from importlib import import_module

    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES.get(name, 'client.client')}"), name)
