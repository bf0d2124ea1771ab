"""This process as a whole: the options of what a process does once, the device on which it computes, and the versions
of what it runs.

A process binds OpenGL to a platform, loads the kernels, chooses a device, and knows the folder of weights and other
downloaded files. It calls `use` when it starts. One that never does, such as a researcher's, has the defaults.

The API checks the setting of the device, too, and it loads no torch: nothing here imports it before it is needed.
"""

import os
import platform
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from scene_attack.errors import InvalidRequest
from scene_attack.options import DEFAULTS, Options

if TYPE_CHECKING:
    import torch
    from torch import Tensor


ONCE = {"cache": "cache_dir", "device": "device", "gl": "gl", "kernels": "kernels"}
"""The options of which a process has one value, each with the attribute that holds it, a path being absolute there."""

ALLOCATOR = {
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(8 * 2**30),
    "MALLOC_TOP_PAD_": str(256 * 2**20),
}
"""Settings with which glibc keeps large freed blocks. By default it returns them to the system at once, and page faults
raise the CPU time of a pass of 28 images from 370 to 560 ms. glibc reads them at start, so the parent sets them."""


def program(module: str, *arguments: str) -> list[str]:
    """The command that runs a module of ours by this Python.

    -P: a file of the user's own in the folder where the command is given, `queue.py` say, is not taken for Python's.
    """
    return [sys.executable, "-P", "-m", module, *arguments]


_options: Options | None = None


def use(asked: Options) -> None:
    """Sets the options of this process, before anything asks for them.

    Calling it again with the same options does nothing. Raises InvalidRequest, which names the variable, for a value
    that differs from the one that this process has.
    """
    global _options
    if _options is None:
        _options = asked
    for name, attribute in ONCE.items():
        has, value = getattr(_options, attribute), getattr(asked, attribute)
        if value != has:
            detail = f"this process has {has} already and cannot change to {value}; start another process"
            raise InvalidRequest(f"SCENE_ATTACK_{name.upper()}", detail)


def options() -> Options:
    """Returns the options of this process. From the first call on they are fixed."""
    global _options
    if _options is None:
        _options = DEFAULTS
    return _options


@contextmanager
def replaced(**changes: str | Path) -> Iterator[None]:
    """Replaces options as long as the context lasts, to compare them. What was loaded before stays loaded."""
    global _options
    before = options()
    _options = before.model_copy(update=changes)
    try:
        yield
    finally:
        _options = before


def device() -> "torch.device":
    """Returns the device of the setting; "auto" is the first CUDA device if there is one, else the CPU.

    Raises InvalidRequest, naming the setting, for a device that does not exist.
    """
    import torch

    name = options().device
    if name == "cpu" or (name == "auto" and not torch.cuda.is_available()):
        return torch.device("cpu")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    index = int(name.partition(":")[2] or 0)
    if index >= count:
        there = f"{count} CUDA device{'s' if count > 1 else ''}, numbered from 0" if count else "no CUDA device"
        raise InvalidRequest(f"SCENE_ATTACK_DEVICE={name}", f"this machine has {there}; use auto or cpu")
    _make_deterministic()
    return torch.device("cuda", index)


def check_device() -> None:
    """Raises InvalidRequest, naming the setting, where the device is not there. Imports torch only to look for CUDA."""
    if options().device not in ("auto", "cpu"):
        device()


def describe(where: "torch.device") -> str:
    """Returns a device's part of a backend string: "cpu" with the processor, or the CUDA device and its model."""
    import torch

    if where.type == "cuda":
        return f"{where} ({torch.cuda.get_device_name(where)})"
    return f"{where.type} ({processor()})" if where.type == "cpu" else where.type


@lru_cache(maxsize=1)
def cpuinfo() -> dict[str, str]:
    """What Linux says of the first processor, by the names of /proc/cpuinfo; empty elsewhere."""
    try:
        first = Path("/proc/cpuinfo").read_text().partition("\n\n")[0]
    except OSError:
        return {}
    fields = (line.partition(":") for line in first.splitlines())
    return {name.strip(): value.strip() for name, _, value in fields}


def processor() -> str:
    """The kind of this machine's processor, e.g. "GenuineIntel 6.207" with family and model.

    Mesa and torch compile or choose code by it: on two kinds the same scene differs by 1/255 in a few pixels, from
    which an attack goes another way.
    """
    vendor, family, model = (cpuinfo().get(name) for name in ("vendor_id", "cpu family", "model"))
    return f"{vendor} {family}.{model}" if vendor else platform.machine()


def _make_deterministic() -> None:
    """Makes CUDA's libraries deterministic where they can be, and turns off TensorFloat-32.

    Torch warns of what it computes in no fixed order there: the gradient of the resizing before a network, for one.
    """
    import torch

    _expect_no_context()
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # read when cuBLAS is first used
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cudnn.benchmark = False
    torch.use_deterministic_algorithms(True, warn_only=True)


@lru_cache(maxsize=1)
def _expect_no_context() -> None:
    """Keeps torch's thread for gradients from warning that it has no CUDA context before it makes one.

    Once in a process: whenever Python's filters change, it shows again every warning that it has shown.
    """
    warnings.filterwarnings("ignore", "Attempting to run cuBLAS, but there was no current CUDA context")


def finite(values: "Tensor") -> bool:
    """Returns whether every value is finite. The minimum and maximum, which a single pass computes, suffice."""
    low, high = values.detach().aminmax()
    return isfinite(float(low)) and isfinite(float(high))


@lru_cache
def versions(*packages: str) -> dict[str, str]:
    """Returns the versions of Python and of the installed `packages` by name. Cached, as reading takes milliseconds."""
    found = {"python": platform.python_version()}
    for name in packages:
        with suppress(PackageNotFoundError):  # one of an extra
            found[name] = version(name)
    return found
