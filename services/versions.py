"""Which versions made a result."""

import platform
from functools import lru_cache
from importlib.metadata import version


@lru_cache
def versions(*packages: str) -> dict[str, str]:
    """Of Python and of installed packages. Read once in a process: it takes milliseconds, in every job."""
    return {"python": platform.python_version()} | {name: version(name) for name in packages}
