"""The command line, the clients of a service, and `attack`, which attacks a network of the caller's own process."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from client.async_client import AsyncClient, AsyncJob
    from client.client import Client
    from client.in_process import attack
    from client.job import Job, Unfinished
    from client.job_images import images
    from client.request import ApiError

__all__ = ["ApiError", "AsyncClient", "AsyncJob", "Client", "Job", "Unfinished", "attack", "images"]

_MODULES = {
    "ApiError": "request",
    "AsyncClient": "async_client",
    "AsyncJob": "async_client",
    "Client": "client",
    "Job": "job",
    "Unfinished": "job",
    "attack": "in_process",
    "images": "job_images",
}


def __getattr__(name: str) -> Any:
    """Imports what is asked for: a command line that starts needs neither."""
    from importlib import import_module

    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
