"""The command line, the clients of a service, and `attack`, which attacks a network of the caller's own process."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from client.client import AsyncClient, AsyncJob, Client, Job, images
    from client.errors import ApiError, Unfinished
    from client.in_process import attack

__all__ = ["ApiError", "AsyncClient", "AsyncJob", "Client", "Job", "Unfinished", "attack", "images"]

DEFAULT_URL = "http://127.0.0.1:8008"
"""The service of this machine."""
_MODULES = {"ApiError": "errors", "Unfinished": "errors", "attack": "in_process"}
"""The module of each name; all others are in `client.client`."""


def __getattr__(name: str) -> Any:
    """Imports what is asked for: a command line that starts needs none of it."""
    from importlib import import_module

    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES.get(name, 'client')}"), name)
