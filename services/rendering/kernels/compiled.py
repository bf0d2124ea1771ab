"""The compiled inner loops of shading and rasterising : built once per machine into the cache, then loaded.

Where there is no compiler the same sums run in torch, some ten times slower, and OpenGL draws all pictures;
`SCENE_ATTACK_KERNEL` decides. The loops call no Python and use `torch.get_num_threads()` threads, which never changes
their bits.
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import structlog
import torch
from torch import Tensor

from services.errors import JobFailure
from services.settings import settings

SOURCES = Path(__file__).parent
SUFFIXES = (".cpp", ".h")
FLAGS = ("-O3", "-march=native", "-mprefer-vector-width=512", "-fno-math-errno", "-fno-trapping-math", "-std=c++17")
BUILD = ("-fopenmp", "-shared", "-fPIC", "-Wno-maybe-uninitialized", "-Wno-ignored-attributes")
NAMES = {torch.float32: "float", torch.float64: "double"}


_LAYOUT: list[tuple[str, Any]] = [
    *((name, ctypes.c_int64) for name in ("count", "directions")),
    *((name, ctypes.c_int) for name in ("channels", "lobes")),
    *(
        (name, ctypes.c_void_p)
        for name in ("normals", "towards", "half", "light", "base", "tilt", "log_kappa", "gamma")
    ),
]
"""`Scene` of shading.cpp up to its numbers."""
_NUMBERS = ("cosine_floor", "lowest", "highest")


class SceneFloat(ctypes.Structure):
    """Scene<float>."""

    _fields_ = (*_LAYOUT, *((name, ctypes.c_float) for name in _NUMBERS))


class SceneDouble(ctypes.Structure):
    """Scene<double>."""

    _fields_ = (*_LAYOUT, *((name, ctypes.c_double) for name in _NUMBERS))


_PERSPECTIVE: list[tuple[str, Any]] = [
    *_LAYOUT[:4],
    *((name, ctypes.c_void_p) for name in ("normals", "viewers", "towards", "light", "material")),
]
"""`Scene` of perspective.cpp up to its numbers."""
_MORE_NUMBERS = (*_NUMBERS, "most_kappa", "most_gamma")


class PerspectiveFloat(ctypes.Structure):
    """Scene<float> of the perspective sum."""

    _fields_ = (*_PERSPECTIVE, *((name, ctypes.c_float) for name in _MORE_NUMBERS))


class PerspectiveDouble(ctypes.Structure):
    """Scene<double> of the perspective sum."""

    _fields_ = (*_PERSPECTIVE, *((name, ctypes.c_double) for name in _MORE_NUMBERS))


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL | None:
    """The loaded loops, built first if need be (some 10 s); None where torch does the work.

    Raises JobFailure("internal") where SCENE_ATTACK_KERNEL=native and they cannot be built.
    """
    wanted = settings().kernel
    if wanted == "torch":
        return None
    try:
        return ctypes.CDLL(str(_built()))
    except (OSError, subprocess.CalledProcessError) as error:
        said = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
        if wanted == "native":
            raise JobFailure("internal", f"cannot build the shading loops ({said}); install g++") from error
        structlog.get_logger().warning("no native shading: torch does it, some ten times slower", error=said)
        return None


def runs(values: Tensor) -> bool:
    """Whether the loops do the work for `values`: on the CPU, of a dtype they know."""
    return values.device.type == "cpu" and values.dtype in NAMES and library() is not None


def backend() -> str:
    """What computes the sums: decides the bits of a picture."""
    return "torch" if library() is None else f"native {_key()[:8]}"


def call(name: str, dtype: torch.dtype, *arguments: object) -> None:
    """Call `name` of the library for float32 or float64, with the number of threads torch uses.

    Tensors are handed over as pointers: contiguous, on the CPU, of `dtype` (or what the loop asks for); floats as
    `dtype`, integers of 64 bits.
    """
    loaded = library()
    assert loaded is not None
    getattr(loaded, f"{name}_{NAMES[dtype]}")(*(_plain(argument, dtype) for argument in arguments))


def _plain(argument: object, dtype: torch.dtype) -> object:
    if isinstance(argument, Tensor):
        assert argument.is_contiguous()
        return ctypes.c_void_p(argument.data_ptr())
    if isinstance(argument, ctypes.Structure):
        return ctypes.byref(argument)
    if isinstance(argument, float):
        return ctypes.c_float(argument) if dtype == torch.float32 else ctypes.c_double(argument)
    return ctypes.c_int64(argument) if isinstance(argument, int) else argument


def threads() -> ctypes.c_int:
    """The last argument of the loops that run in parallel."""
    return ctypes.c_int(torch.get_num_threads())


def _compiler() -> str:
    found = shutil.which(os.environ.get("CXX", "g++"))
    if found is None:
        raise OSError("there is no C++ compiler (g++)")
    return found


@lru_cache(maxsize=1)
def _key() -> str:
    """Of everything the machine code depends on: source, flags, compiler and processor."""
    about = Path(_compiler()).resolve()
    processor = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("model", "flags"))]
    stat = about.stat()
    sources = [path.read_text() for path in sorted(SOURCES.iterdir()) if path.suffix in SUFFIXES]
    words = [*sources, *FLAGS, *BUILD, str(about), str(stat.st_size), str(stat.st_mtime_ns), *processor[:3]]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


def _built() -> Path:
    path = settings().cache_dir / "native" / f"{_key()}.so"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            part = Path(folder) / "native.so"
            command = [_compiler(), *FLAGS, *BUILD, "-o", str(part), *map(str, sorted(SOURCES.glob("*.cpp")))]
            subprocess.run(command, check=True, capture_output=True, text=True)
            part.replace(path)  # two builds at once: both whole, the last one stays
    return path


if __name__ == "__main__":
    library()
