"""Loads the compiled kernels of shading and rasterising, once per process, and calls them.

Without them the same sums run in torch, about ten times slower, and OpenGL draws all images; `SCENE_ATTACK_KERNEL`
selects. The kernels call no Python and use `torch.get_num_threads()` threads, whose number never changes their bits.
They run on the CPU only: tensors on another device are computed by torch.
"""

import ctypes
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import structlog
import torch
from torch import Tensor

from services.errors import JobFailure
from services.rendering.kernels import build, layouts
from services.rendering.kernels.structures import STRUCTURES
from services.settings import settings

NAMES = {torch.float32: "float", torch.float64: "double"}
POINTEES = {
    torch.float32: "float32*",
    torch.float64: "float64*",
    torch.int32: "int32*",
    torch.int64: "int64*",
    torch.uint8: "uint8*",
    torch.bool: "uint8*",
}


@dataclass(frozen=True)
class Library:
    """The loaded kernels: their functions by name, their exported layouts, and the identity of their manifest."""

    functions: Mapping[str, Callable[..., None]]
    exports: layouts.Exports
    identity: str
    checked: set[tuple[str, type]] = field(default_factory=set)

    def agree(self, structure: type[ctypes.Structure], name: str) -> None:
        """Compares a Python structure with the library's. Raises LayoutError, naming the field, if they differ."""
        if (name, structure) not in self.checked:
            layouts.check(structure, name, self.exports)
            self.checked.add((name, structure))


@lru_cache(maxsize=1)
def library() -> Library | None:
    """Returns the loaded kernels, compiled first if necessary (about 10 s); None if torch computes instead.

    Raises JobFailure("internal") if SCENE_ATTACK_KERNEL=native and there are no kernels, LayoutError if Python's
    structures differ from the library's.
    """
    wanted = settings().kernel
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
    """Sets the functions' argument types from the library's own table, and compares the structures of STRUCTURES."""
    table = loaded.layout_table
    table.argtypes, table.restype = [], ctypes.c_char_p
    exports = layouts.parse(table().decode())
    functions = {}
    for name, words in exports.functions.items():
        functions[name] = loaded[name]
        functions[name].argtypes, functions[name].restype = layouts.argument_types(words), None
    described = Library(functions, exports, identity)
    for name, structure in STRUCTURES.items():
        described.agree(structure, name)
    return described


def runs(values: Tensor) -> bool:
    """Returns whether the kernels can process `values`: on the CPU, float32 or float64, and loaded."""
    return values.device.type == "cpu" and values.dtype in NAMES and library() is not None


def backend() -> str:
    """Returns the CPU implementation for the backend string: "torch", or "native" and the kernels' identity."""
    loaded = library()
    return "torch" if loaded is None else f"native {loaded.identity}"


def call(name: str, dtype: torch.dtype, *arguments: object) -> None:
    """Calls the function `name` of the library for float32 or float64. The last argument of most is `threads()`.

    Tensors are passed as pointers; they must be contiguous, on the CPU, and of the dtype that the function takes.
    Structures and arrays of them are passed as pointers after their layout has been compared. None is a null pointer.

    Raises TypeError for a wrong number or type of arguments, LayoutError for a structure that differs.
    """
    loaded = library()
    assert loaded is not None
    full = f"{name}_{NAMES[dtype]}"
    words = loaded.exports.functions[full]
    if len(words) != len(arguments):
        raise TypeError(f"{full} takes {len(words)} arguments, not {len(arguments)}")
    loaded.functions[full](
        *(_plain(loaded, argument, word, full) for argument, word in zip(arguments, words, strict=True))
    )


def _plain(loaded: Library, argument: object, word: str, name: str) -> object:
    """Converts an argument for ctypes, given the name `word` of its C++ type."""
    if isinstance(argument, Tensor):
        if POINTEES.get(argument.dtype) != word or not argument.is_contiguous() or argument.device.type != "cpu":
            raise TypeError(
                f"{name} takes a contiguous {word} on the CPU, not a tensor of {argument.dtype}, "
                f"strides {argument.stride()}, on {argument.device}"
            )
        return argument.data_ptr()
    if isinstance(argument, ctypes.Structure | ctypes.Array):
        kind = type(argument) if isinstance(argument, ctypes.Structure) else argument._type_
        loaded.agree(kind, word.removesuffix("*"))
        return ctypes.addressof(argument)  # the caller's frame keeps it alive during the call
    return argument


def threads() -> int:
    """Returns the number of threads for parallel kernels, which is torch's."""
    return torch.get_num_threads()
