"""Reads the versions of Python and packages, which are recorded with a result."""

import platform
from functools import lru_cache
from importlib.metadata import version


@lru_cache
def versions(*packages: str) -> dict[str, str]:
    """Returns the versions of Python and of the installed `packages` by name. Cached, as reading takes milliseconds."""
    return {"python": platform.python_version()} | {name: version(name) for name in packages}
