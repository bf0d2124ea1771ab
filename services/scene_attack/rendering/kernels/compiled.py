"""Loads the compiled kernels of shading and rasterising, once per process, and calls them.

Without them the same sums run in torch, several times slower, and OpenGL draws all images; the option `kernels`
selects (levels.py). The kernels call no Python and use `torch.get_num_threads()` threads, whose number never changes
their bits. They run on the CPU only: tensors on another device are computed by torch.

The C++ sources export a text table (`layout.h`): the argument types of every function, and the size of every structure
with the name, offset, size and type of each field. Nothing here repeats a layout, so that a field that is moved in the
sources moves here too. A tensor or an array becomes a pointer, after its element type, contiguity and device have been
compared; a sequence becomes an array; a structure is made by `structure` from values given by name.
"""

import ctypes
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import structlog
import torch
from torch import Tensor

from scene_attack.process import options
from scene_attack.rendering.kernels import levels

SCALARS: dict[str, Any] = {
    "float32": ctypes.c_float,
    "float64": ctypes.c_double,
    "int32": ctypes.c_int32,
    "int64": ctypes.c_int64,
    "uint8": ctypes.c_uint8,
}
"""The ctypes class of each scalar type name in the table. A pointer's name is that of its type followed by a star."""


class LayoutError(TypeError):
    """The library's description of itself cannot be read, or contradicts this platform's ctypes."""


@dataclass(frozen=True)
class Structure:
    """A structure as the compiler laid it out: its ctypes class, and the type name of each field, in order."""

    kind: type[ctypes.Structure]
    words: Mapping[str, str]


@dataclass(frozen=True)
class Exports:
    """The parsed table: the argument type names of each function, and the structures, by name."""

    functions: Mapping[str, tuple[str, ...]]
    structures: Mapping[str, Structure]


def parse(table: str) -> Exports:
    """Parses the table that the library exports. Raises LayoutError for a malformed line, an unknown type, or a layout
    that ctypes does not reproduce.
    """
    functions: dict[str, tuple[str, ...]] = {}
    structures: dict[str, Structure] = {}
    # The size of each structure; the offset, size and type name of its fields.
    layouts: dict[str, tuple[int, dict[str, tuple[int, int, str]]]] = {}
    for line in table.splitlines():
        match line.split():
            case ["structure", name, size] if name not in layouts:
                layouts[name] = int(size), {}
            case ["field", name, offset, size, word] if layouts:
                layouts[list(layouts)[-1]][1][name] = int(offset), int(size), word
            case ["function", name, *words]:
                functions[name] = tuple(words)
            case _:
                raise LayoutError(f"the compiled library describes itself by a line that cannot be read: {line!r}")
    for name, (extent, fields) in layouts.items():
        structures[name] = _structure(name, extent, dict(sorted(fields.items(), key=lambda item: item[1])), structures)
    return Exports(functions, structures)


def argument_types(words: tuple[str, ...]) -> list[Any]:
    """Returns the ctypes classes of a function's arguments; every pointer is a `c_void_p`."""
    return [_kind(word, {}) for word in words]


def _structure(
    name: str, size: int, fields: dict[str, tuple[int, int, str]], others: Mapping[str, Structure]
) -> Structure:
    """Makes the structure of `size` bytes from its fields in order: their offset, size and type name."""
    words = {field: word for field, (_, _, word) in fields.items()}
    members = [(field, _kind(word, others)) for field, word in words.items()]
    kind: type[ctypes.Structure] = type(name, (ctypes.Structure,), {"_fields_": members})
    for field, (offset, width, _) in fields.items():
        here = getattr(kind, field)
        if (here.offset, here.size) != (offset, width):
            raise LayoutError(
                f"structure {name}, field {field}: ctypes has {here.size} bytes at offset {here.offset}, "
                f"the compiled library {width} at {offset}"
            )
    if ctypes.sizeof(kind) != size:
        raise LayoutError(f"structure {name}: ctypes has {ctypes.sizeof(kind)} bytes, the compiled library {size}")
    return Structure(kind, words)


def _kind(word: str, structures: Mapping[str, Structure]) -> Any:
    """Returns the ctypes class of a type name."""
    if word.endswith("*"):
        return ctypes.c_void_p
    element, bracket, count = word.removesuffix("]").partition("[")
    if element in structures:
        return structures[element].kind
    if element not in SCALARS:
        raise LayoutError(f"the compiled library names a type that is not known: {word}")
    return SCALARS[element] * int(count) if bracket else SCALARS[element]


def make_structure(exports: Exports, name: str, **values: object) -> ctypes.Structure:
    """Makes the structure `name`, which holds the values it points to.

    Raises TypeError, naming the field, for one that is missing, unknown or of another type.
    """
    layout = exports.structures[name]
    if different := sorted(set(values) ^ set(layout.words)):
        reason = "is missing" if different[0] in layout.words else "is not one of " + ", ".join(layout.words)
        raise TypeError(f"structure {name}: {different[0]} {reason}")
    held: list[object] = []
    instance: Any = layout.kind(
        *(argument(exports, values[field], word, f"{name}.{field}", held) for field, word in layout.words.items())
    )
    instance.held = held
    return instance  # type: ignore[no-any-return]


def argument(exports: Exports, value: Any, word: str, where: str, held: list[object]) -> Any:
    """Converts a value for ctypes, given the name `word` of its C++ type; None is a null pointer. What a pointer points
    to is added to `held`, which must outlive it. Raises TypeError, naming `where`.
    """
    held.append(value)
    if isinstance(value, ctypes.Structure):
        name = type(value).__name__
        if name != word.removesuffix("*"):
            raise TypeError(f"{where} takes {word}, not a structure {name}")
        return ctypes.addressof(value) if word.endswith("*") else value
    if word.endswith("]"):
        element, count = word.removesuffix("]").split("[")
        if len(value) != int(count):
            raise TypeError(f"{where} takes {count} numbers, not {len(value)}")
        return (SCALARS[element] * int(count))(*value)
    if isinstance(value, Tensor | np.ndarray):
        return _address(value, word, where)
    if word.endswith("*") and isinstance(value, Sequence):
        inner = word.removesuffix("*")
        kind: Any = ctypes.c_void_p if inner.endswith("*") else exports.structures[inner].kind
        array = (kind * len(value))(*(argument(exports, item, inner, where, held) for item in value))
        held.append(array)
        return ctypes.addressof(array)
    return value


def _address(array: Any, word: str, where: str) -> int:
    """Returns where the elements of a tensor or an array lie, which must be contiguous and on the CPU."""
    tensor = isinstance(array, Tensor)
    element = str(array.dtype).removeprefix("torch.").replace("bool", "uint8")
    contiguous = array.is_contiguous() if tensor else array.flags.c_contiguous
    if element + "*" != word or not contiguous or (tensor and array.device.type != "cpu"):
        on = f", strides {array.stride()}, on {array.device}" if tensor else f", strides {array.strides}"
        raise TypeError(f"{where} takes {word}, contiguous and on the CPU, not {array.dtype}{on}")
    return int(array.data_ptr() if tensor else array.ctypes.data)


NAMES = {torch.float32: "float", torch.float64: "double"}


@dataclass(frozen=True)
class Library:
    """The loaded kernels: their functions by name, their exported layouts, and what a backend string says of them."""

    functions: Mapping[str, Callable[..., None]]
    exports: Exports
    name: str
    """The level and sixteen digits of the SHA-256 of the library's bytes: the same sources, flags and compiler give the
    same bytes, in a wheel and in a checkout."""


@lru_cache(maxsize=1)
def library() -> Library | None:
    """Returns the loaded kernels; None if torch computes instead.

    Raises InvalidRequest, naming the setting, if SCENE_ATTACK_KERNELS asks for a level that cannot be loaded;
    LayoutError if Python's structures differ from the library's.
    """
    level = levels.level()
    if level is None:
        if options().kernels == "auto":
            structlog.get_logger().warning("no kernels: torch does their work, more slowly", reason=levels.why_none())
        return None
    path = levels.library_path(level)
    return _described(ctypes.CDLL(str(path)), f"{level} {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}")


def _described(loaded: ctypes.CDLL, name: str) -> Library:
    """Sets the functions' argument types from the library's own table."""
    table = loaded.layout_table
    table.argtypes, table.restype = [], ctypes.c_char_p
    exports = parse(table().decode())
    functions = {}
    for function, words in exports.functions.items():
        functions[function] = loaded[function]
        functions[function].argtypes, functions[function].restype = argument_types(words), None
    return Library(functions, exports, name)


def runs(values: Tensor) -> bool:
    """Returns whether the kernels can process `values`: on the CPU, float32 or float64, and loaded."""
    return values.device.type == "cpu" and values.dtype in NAMES and library() is not None


def backend() -> str:
    """Returns the CPU implementation for the backend string: "torch", or "native" with the level and the hash."""
    loaded = library()
    return "torch" if loaded is None else f"native {loaded.name}"


def structure(name: str, **values: object) -> ctypes.Structure:
    """Makes the structure `name` of the library from values given by name, as `call` takes them; it holds what it
    points to. Raises TypeError, naming the field, for one that is missing, unknown or of another type.
    """
    return make_structure(_loaded().exports, name, **values)


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
    pairs = zip(values, words, strict=True)
    loaded.functions[full](*(argument(loaded.exports, value, word, full, held) for value, word in pairs))


def _loaded() -> Library:
    loaded = library()
    assert loaded is not None
    return loaded


def threads() -> int:
    """Returns the number of threads for parallel kernels, which is torch's."""
    return torch.get_num_threads()
