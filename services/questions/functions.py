"""The functions that a question's program is made of, and their types.

They are those of CLEVR (Johnson et al. 2017). A function takes the outputs of earlier ones, and some take a value that
stands in the program, such as the colour in `filter_color[red]`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from services.scenes.clevr.records import ATTRIBUTES, RELATIONS

Type = Literal["set", "object", "integer", "boolean", "size", "color", "material", "shape"]
"""What a function takes or gives: a set of objects, one object, a number, a truth value, a value of an attribute."""


@dataclass(frozen=True)
class Function:
    """A function: the types of its inputs and output, and the values it may have (none: it has no value)."""

    name: str
    inputs: tuple[Type, ...]
    output: Type
    values: tuple[str, ...] = ()


ATTRIBUTE_TYPES: tuple[Type, ...] = ("size", "color", "material", "shape")


def _catalogue() -> Iterator[Function]:
    yield Function("scene", (), "set")
    yield Function("unique", ("set",), "object")
    yield Function("relate", ("object",), "set", RELATIONS)
    yield Function("union", ("set", "set"), "set")
    yield Function("intersect", ("set", "set"), "set")
    yield Function("count", ("set",), "integer")
    yield Function("exist", ("set",), "boolean")
    for attribute in ATTRIBUTE_TYPES:
        yield Function(f"filter_{attribute}", ("set",), "set", ATTRIBUTES[attribute])
        yield Function(f"query_{attribute}", ("object",), attribute)
        yield Function(f"same_{attribute}", ("object",), "set")
        yield Function(f"equal_{attribute}", (attribute, attribute), "boolean")
    for comparison in ("equal_integer", "less_than", "greater_than"):
        yield Function(comparison, ("integer", "integer"), "boolean")


FUNCTIONS: dict[str, Function] = {function.name: function for function in _catalogue()}
"""All functions by name."""
