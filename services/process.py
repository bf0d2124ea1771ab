"""This process as a whole: the options of what a process does once, and the versions of what it runs.

A process binds OpenGL to a platform, loads the kernels, chooses a device, and knows the folder of weights and other
downloaded files. It calls `use` when it starts. One that never does, such as a researcher's, has the defaults.
"""

import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from services.errors import InvalidRequest
from services.settings import DEFAULTS, Settings


@dataclass(frozen=True)
class ProcessOptions:
    """The settings of these names, with absolute paths."""

    cache: Path
    kernel: str
    kernel_arch: str
    kernel_dir: Path
    gl: str
    device: str


_options: ProcessOptions | None = None


def use(settings: Settings) -> None:
    """Sets the options of this process, before anything asks for them.

    Calling it again with the same settings does nothing. Raises InvalidRequest, which names the variable, for a value
    that differs from the one that this process has.
    """
    global _options
    asked = _of(settings)
    if _options is None:
        _options = asked
    for name, value in vars(asked).items():
        has = getattr(_options, name)
        if value != has:
            detail = f"this process has {has} already and cannot change to {value}; start another process"
            raise InvalidRequest(f"SCENE_ATTACK_{name.upper()}", detail)


def options() -> ProcessOptions:
    """Returns the options of this process. From the first call on they are fixed."""
    global _options
    if _options is None:
        _options = _of(DEFAULTS)
    return _options


@contextmanager
def replaced(**changes: str | Path) -> Iterator[None]:
    """Replaces options as long as the context lasts, to compare them. What was loaded before stays loaded."""
    global _options
    before = options()
    _options = replace(before, **changes)  # type: ignore[arg-type]
    try:
        yield
    finally:
        _options = before


def _of(settings: Settings) -> ProcessOptions:
    return ProcessOptions(
        cache=settings.cache_dir,
        kernel=settings.kernel,
        kernel_arch=settings.kernel_arch,
        kernel_dir=settings.kernel_folder,
        gl=settings.gl,
        device=settings.device,
    )


@lru_cache
def versions(*packages: str) -> dict[str, str]:
    """Returns the versions of Python and of the installed `packages` by name. Cached, as reading takes milliseconds."""
    return {"python": platform.python_version()} | {name: version(name) for name in packages}
