"""A question's functional program: its functions and their types, its checks, its form in CLEVR's files, and as a text.

The functions are those of CLEVR (Johnson et al. 2017). A function takes the outputs of earlier ones, and some take a
value that stands in the program, such as the colour in `filter_color[red]`. Targets that answer questions take one
text: a question's words, or its program as JSON (`written`).
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from scene_attack.errors import InvalidRequest
from scene_attack.text import there_are
from scene_attack_questions.clevr.records import ATTRIBUTES, RELATIONS

Type = Literal["set", "object", "integer", "boolean", "size", "color", "material", "shape"]
"""Type of an input or output: a set of objects, one object, a number, a truth value, a value of an attribute."""


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


MAX_NODES = 64
"""Largest program that is accepted; CLEVR's have at most 26 nodes."""

Reason = Literal["form", "function", "arity", "type", "value", "order", "unused", "root"]
"""Why a program is invalid.

form: it is not written as CLEVR's are, or has no node or too many; function: there is no such function; arity: a wrong
number of inputs or values; type: an input of the wrong type; value: a value that the function does not take; order: an
input that is not an earlier node; unused: a node that nothing uses; root: the last node gives no answer.
"""


class InvalidProgram(InvalidRequest):
    """A program is invalid: `node` is the index of the first invalid node, None for the program as a whole."""

    def __init__(self, node: int | None, reason: Reason, detail: str) -> None:
        super().__init__("program" if node is None else f"program.{node}", detail)
        self.node = node
        self.reason: Reason = reason

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.node, self.reason, self.detail)


@dataclass(frozen=True)
class Node:
    """A call of a function: the indices of the nodes it takes, and its values, such as ("red",)."""

    function: str
    inputs: tuple[int, ...]
    values: tuple[str, ...]

    @property
    def label(self) -> str:
        """The function with its values: "filter_color[red]"."""
        return f"{self.function}[{', '.join(self.values)}]" if self.values else self.function


@dataclass(frozen=True)
class Program:
    """Calls in topological order: inputs are indices of earlier nodes, the last node is the root."""

    nodes: tuple[Node, ...]

    @classmethod
    def read(cls, written: object) -> "Program":
        """Reads a program of CLEVR's question files, or as CLEVR's generator has it (`type` and `side_inputs`).

        Raises InvalidProgram("form") for anything else; the program may still be invalid (`check`).
        """
        if not isinstance(written, Sequence) or isinstance(written, str):
            raise InvalidProgram(None, "form", "it must be a list of functions")
        return cls(tuple(_node(index, node) for index, node in enumerate(written)))

    def written(self) -> list[dict[str, Any]]:
        """Returns the program as in CLEVR's question files."""
        return [
            {"function": node.function, "inputs": list(node.inputs), "value_inputs": list(node.values)}
            for node in self.nodes
        ]

    @cached_property
    def types(self) -> tuple[Type, ...]:
        """The type of each node's output. Raises InvalidProgram for the first invalid node."""
        if not 0 < len(self.nodes) <= MAX_NODES:
            raise InvalidProgram(None, "form", f"it has {len(self.nodes)} nodes; it needs 1 to {MAX_NODES}")
        types: list[Type] = []
        for index, node in enumerate(self.nodes):
            types.append(_checked(index, node, types))
        used = {source for node in self.nodes for source in node.inputs}
        for index, node in enumerate(self.nodes[:-1]):
            if index not in used:
                raise InvalidProgram(index, "unused", f"nothing uses the output of {node.label}")
        if types[-1] in ("set", "object"):
            raise InvalidProgram(
                len(types) - 1, "root", f"{self.nodes[-1].label} gives {TYPE_WORDS[types[-1]]}, which is no answer"
            )
        return tuple(types)

    def check(self) -> None:
        """Raises InvalidProgram, which names the first invalid node and why it is."""
        _ = self.types


TYPE_WORDS: dict[Type, str] = {
    "set": "a set of objects",
    "object": "an object",
    "integer": "a number",
    "boolean": "yes or no",
    "size": "a size",
    "color": "a color",
    "material": "a material",
    "shape": "a shape",
}
"""The types in words."""


def _node(index: int, written: object) -> Node:
    if not isinstance(written, dict):
        raise InvalidProgram(index, "form", "it must be an object with function, inputs and value_inputs")
    function = written.get("function", written.get("type"))
    inputs = written.get("inputs", [])
    values = written.get("value_inputs", written.get("side_inputs", []))
    if not isinstance(function, str):
        raise InvalidProgram(index, "form", "its function must be a name")
    if not isinstance(inputs, (list, tuple)) or any(type(k) is not int for k in inputs):
        raise InvalidProgram(index, "form", "its inputs must be a list of indices of earlier nodes")
    if not isinstance(values, (list, tuple)) or any(not isinstance(value, str) for value in values):
        raise InvalidProgram(index, "form", "its value_inputs must be a list of words")
    return Node(function, tuple(inputs), tuple(values))


def _checked(index: int, node: Node, before: Sequence[Type]) -> Type:
    """Returns the type of a node's output; `before` has those of the nodes before it."""
    function = FUNCTIONS.get(node.function)
    if function is None:
        raise InvalidProgram(
            index, "function", f"there is no function {node.function!r}; {there_are(node.function, FUNCTIONS)}"
        )
    for what, actual, due in (("input", node.inputs, function.inputs), ("value", node.values, function.values[:1])):
        if len(actual) != len(due):
            raise InvalidProgram(
                index, "arity", f"{node.function} takes {_number(len(due), what)}, and has {len(actual)}"
            )
    for value in node.values:
        if value not in function.values:
            raise InvalidProgram(
                index, "value", f"{node.function} takes no value {value!r}; {there_are(value, function.values)}"
            )
    for place, (source, needed) in enumerate(zip(node.inputs, function.inputs, strict=True), 1):
        if not 0 <= source < index:
            raise InvalidProgram(index, "order", f"input {place} of {node.function} is {source}, no earlier node")
        if before[source] != needed:
            raise InvalidProgram(
                index,
                "type",
                f"input {place} of {node.function} is {TYPE_WORDS[before[source]]}, that of node {source}; "
                f"it must be {TYPE_WORDS[needed]}",
            )
    return function.output


def _number(count: int, what: str) -> str:
    return f"no {what}" if not count else f"{count} {what}" if count == 1 else f"{count} {what}s"


def written(program: Program) -> str:
    """Returns a program as a text, JSON as in CLEVR's question files."""
    return json.dumps(program.written(), separators=(",", ":"))


def program_in(question: str) -> Program | None:
    """Returns the program that a text is, checked; None for a question in words.

    Raises InvalidProgram for a program that is invalid, InvalidRequest("question") for what begins as a program's JSON
    and is none.
    """
    if not question.lstrip().startswith("["):
        return None
    try:
        program = Program.read(json.loads(question))
    except (json.JSONDecodeError, RecursionError) as error:
        raise InvalidRequest("question", f"it begins as the JSON of a program and is none: {error}") from error
    program.check()
    return program
