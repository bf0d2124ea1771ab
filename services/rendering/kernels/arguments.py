"""Turns Python values into what a compiled function takes, by the type names of the library's own table.

A tensor or an array becomes a pointer, after its element type, contiguity and device have been compared; a sequence
becomes an array; a structure is made by `structure` from values given by name.
"""

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from services.rendering.kernels.layouts import SCALARS, Exports


def structure(exports: Exports, name: str, **values: object) -> ctypes.Structure:
    """Makes the structure `name`, which holds the values it points to.

    Raises TypeError, naming the field, for one that is missing, unknown or of another type.
    """
    layout = exports.structures[name]
    if different := sorted(set(values) ^ set(layout.words)):
        said = "is missing" if different[0] in layout.words else "is not one of " + ", ".join(layout.words)
        raise TypeError(f"structure {name}: {different[0]} {said}")
    held: list[object] = []
    made: Any = layout.kind(
        *(argument(exports, values[field], word, f"{name}.{field}", held) for field, word in layout.words.items())
    )
    made.held = held
    return made  # type: ignore[no-any-return]


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
        array = (kind * len(value))(*(argument(exports, one, inner, where, held) for one in value))
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
