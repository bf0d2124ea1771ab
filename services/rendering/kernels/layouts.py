"""Compares Python's ctypes structures with the layouts that the compiled library exports.

The C++ sources export a text table (`layout.h`): the argument types of every function, and the size of every structure
with the name, offset, size and type of each field. Python's `ctypes.Structure` classes are written by hand and are
compared with the table before they are passed, so that a misplaced field is an error instead of garbage.
"""

import ctypes
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
    """A structure or a function differs between Python and the compiled library."""


@dataclass(frozen=True)
class Field:
    """A field of a structure as the compiler laid it out: offset and size in bytes, and the name of its type."""

    offset: int
    size: int
    word: str


@dataclass(frozen=True)
class StructureLayout:
    """A structure as the compiler laid it out: its size in bytes, and its fields by name, in order."""

    size: int
    fields: dict[str, Field]


@dataclass(frozen=True)
class Exports:
    """The parsed table: the argument type names of each function and the layout of each structure, by name."""

    functions: dict[str, tuple[str, ...]]
    structures: dict[str, StructureLayout]


def parse(table: str) -> Exports:
    """Parses the table that the library exports. Raises LayoutError for a malformed line."""
    functions: dict[str, tuple[str, ...]] = {}
    structures: dict[str, StructureLayout] = {}
    fields: dict[str, Field] = {}
    for line in table.splitlines():
        match line.split():
            case ["structure", name, size]:
                fields = {}
                structures[name] = StructureLayout(int(size), fields)
            case ["field", name, offset, size, word]:
                fields[name] = Field(int(offset), int(size), word)
            case ["function", name, *words]:
                functions[name] = tuple(words)
            case _:
                raise LayoutError(f"the compiled library describes itself by a line that cannot be read: {line!r}")
    return Exports(functions, structures)


def argument_types(words: tuple[str, ...]) -> list[Any]:
    """Returns the ctypes classes of a function's arguments; every pointer is a `c_void_p`."""
    return [ctypes.c_void_p if word.endswith("*") else SCALARS[word] for word in words]


def check(structure: type[ctypes.Structure], name: str, exports: Exports) -> None:
    """Compares a Python structure, and the structures it contains or points to, with the library's of that name.

    Raises LayoutError, naming the structure and the field.
    """
    layout = exports.structures.get(name)
    if layout is None:
        raise LayoutError(f"the compiled library exports no layout of the structure {name}")
    ours = {field[0]: field[1] for field in structure._fields_}
    if list(ours) != list(layout.fields):
        different = [pair for pair in zip(ours, layout.fields, strict=False) if pair[0] != pair[1]]
        first = different[0] if different else (f"{len(ours)} fields", f"{len(layout.fields)} fields")
        raise LayoutError(f"structure {name}: Python has {first[0]} where the compiled library has {first[1]}")
    for field, there in layout.fields.items():
        here = getattr(structure, field)
        if (here.offset, here.size) != (there.offset, there.size):
            raise LayoutError(
                f"structure {name}, field {field}: Python has {here.size} bytes at offset {here.offset}, "
                f"the compiled library {there.size} at {there.offset}"
            )
        _check_type(ours[field], there.word, f"structure {name}, field {field}", exports)
    if ctypes.sizeof(structure) != layout.size:
        raise LayoutError(
            f"structure {name}: Python has {ctypes.sizeof(structure)} bytes, the compiled library {layout.size}"
        )


def _check_type(kind: Any, word: str, where: str, exports: Exports) -> None:
    """Raises LayoutError if a field's ctypes class does not match the library's type name `word`."""
    inner = getattr(kind, "_type_", None)
    if word.removesuffix("*") in exports.structures:
        structure = inner if word.endswith("*") else kind
        if not (isinstance(structure, type) and issubclass(structure, ctypes.Structure)):
            raise LayoutError(f"{where}: Python has {kind.__name__}, the compiled library {word}")
        check(structure, word.removesuffix("*"), exports)
        return
    if word.endswith("*"):
        fits = kind is ctypes.c_void_p
    elif word.endswith("]"):
        element, count = word[:-1].split("[")
        fits = inner is SCALARS[element] and getattr(kind, "_length_", None) == int(count)
    else:
        fits = kind is SCALARS[word]
    if not fits:
        raise LayoutError(f"{where}: Python has {kind.__name__}, the compiled library {word}")
