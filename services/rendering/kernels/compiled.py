"""Loads the compiled kernels of shading and rasterising, once per process, and calls them.

Without them the same sums run in torch, about ten times slower, and OpenGL draws all images; `SCENE_ATTACK_KERNEL`
selects. The kernels call no Python and use `torch.get_num_threads()` threads, whose number never changes their bits.
They run on the CPU only: tensors on another device are computed by torch.
"""

import ctypes
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import structlog
import torch
from torch import Tensor

from services.errors import JobFailure
from services.process import options
from services.rendering.kernels import arguments, build, layouts

NAMES = {torch.float32: "float", torch.float64: "double"}


@dataclass(frozen=True)
class Library:
    """The loaded kernels: their functions by name, their exported layouts, and the identity of their manifest."""

    functions: Mapping[str, Callable[..., None]]
    exports: layouts.Exports
    identity: str


@lru_cache(maxsize=1)
def library() -> Library | None:
    """Returns the loaded kernels, compiled first if necessary (about 10 s); None if torch computes instead.

    Raises JobFailure("internal") if SCENE_ATTACK_KERNEL=native and there are no kernels, LayoutError if Python's
    structures differ from the library's.
    """
    wanted = options().kernel
    if wanted == "torch":
        return None
    try:
        path, manifest = build.library_path()
        loaded = ctypes.CDLL(str(path))
    except (OSError, subprocess.CalledProcessError) as error:
        said = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
        if wanted == "native":
            raise JobFailure("internal", f"there are no kernels: {said}") from error
        structlog.get_logger().warning("no kernels: torch does their work, some ten times slower", error=said)
        return None
    return _described(loaded, manifest.identity)


def _described(loaded: ctypes.CDLL, identity: str) -> Library:
    """Sets the functions' argument types from the library's own table."""
    table = loaded.layout_table
    table.argtypes, table.restype = [], ctypes.c_char_p
    exports = layouts.parse(table().decode())
    functions = {}
    for name, words in exports.functions.items():
        functions[name] = loaded[name]
        functions[name].argtypes, functions[name].restype = layouts.argument_types(words), None
    return Library(functions, exports, identity)


def runs(values: Tensor) -> bool:
    """Returns whether the kernels can process `values`: on the CPU, float32 or float64, and loaded."""
    return values.device.type == "cpu" and values.dtype in NAMES and library() is not None


def backend() -> str:
    """Returns the CPU implementation for the backend string: "torch", or "native" and the kernels' identity."""
    loaded = library()
    return "torch" if loaded is None else f"native {loaded.identity}"


def structure(name: str, **values: object) -> ctypes.Structure:
    """Makes the structure `name` of the library from values given by name, as `call` takes them; it holds what it
    points to. Raises TypeError, naming the field, for one that is missing, unknown or of another type.
    """
    return arguments.structure(_loaded().exports, name, **values)


def call(name: str, dtype: torch.dtype, *values: object) -> None:
    """Calls the function `name` of the library for float32 or float64. The last argument of most is `threads()`.

    Tensors and arrays are passed as pointers; they must be contiguous, on the CPU, and of the dtype that the function
    takes. Structures and sequences of them are passed as pointers, too. None is a null pointer.

    Raises TypeError for a wrong number or type of arguments.
    """
    loaded = _loaded()
    full = f"{name}_{NAMES[dtype]}"
    words = loaded.exports.functions[full]
    if len(words) != len(values):
        raise TypeError(f"{full} takes {len(words)} arguments, not {len(values)}")
    held: list[object] = []
    given = zip(values, words, strict=True)
    loaded.functions[full](*(arguments.argument(loaded.exports, value, word, full, held) for value, word in given))


def _loaded() -> Library:
    loaded = library()
    assert loaded is not None
    return loaded


def threads() -> int:
    """Returns the number of threads for parallel kernels, which is torch's."""
    return torch.get_num_threads()
