"""Reads the table that the compiled library exports of itself, and makes ctypes structures from it.

The C++ sources export a text table (`layout.h`): the argument types of every function, and the size of every structure
with the name, offset, size and type of each field. Nothing here repeats a layout, so that a field that is moved in the
sources moves here too. Values are given by name (`arguments.py`).
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

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
    made = [(field, _kind(word, others)) for field, word in words.items()]
    kind: type[ctypes.Structure] = type(name, (ctypes.Structure,), {"_fields_": made})
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
