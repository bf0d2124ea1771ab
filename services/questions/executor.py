"""Executes a question's program on the truth of a scene."""

from collections.abc import Sequence
from typing import Any

from services.errors import InvalidRequest
from services.questions.answers import MAX_COUNT
from services.questions.facts import Facts, Objects
from services.questions.program import Node, Program

Value = Objects | int | bool | str
"""A node's output: a set or the index of an object, a number, a truth value, or a value of an attribute."""


class IllPosed(InvalidRequest):
    """A program asks for the one object of a set that has none or many. `node` is its `unique`, `found` the number."""

    def __init__(self, node: int, found: int) -> None:
        said = "there is none" if found == 0 else f"there are {found}"
        super().__init__(f"program.{node}", f"unique asks for the only object, and {said}: the question is ill-posed")
        self.node = node
        self.found = found

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.node, self.found)


def answer(program: Program, facts: Facts) -> str:
    """Returns the answer to a question. Raises as `execute` does, and InvalidRequest for a count that is no answer."""
    found = execute(program, facts)[-1]
    if isinstance(found, bool):
        return "yes" if found else "no"
    if isinstance(found, int) and found > MAX_COUNT:
        raise InvalidRequest("program", f"the answer is {found}; numbers above {MAX_COUNT} are no answers")
    return str(found)


def execute(program: Program, facts: Facts) -> tuple[Value, ...]:
    """Returns the output of each node of a program.

    Raises InvalidProgram for an invalid program, and IllPosed for a `unique` of none or many.
    """
    program.check()
    outputs: list[Value] = []
    for index, node in enumerate(program.nodes):
        outputs.append(_output(index, node, [outputs[k] for k in node.inputs], facts))
    return tuple(outputs)


def _output(index: int, node: Node, inputs: Sequence[Any], facts: Facts) -> Value:
    # `check` has seen to the types of the inputs.
    name, _, attribute = node.function.partition("_")
    match name:
        case "scene":
            return facts.everything
        case "filter":
            members: Objects = inputs[0] & facts.having[attribute, node.values[0]]
            return members
        case "unique":
            if len(inputs[0]) != 1:
                raise IllPosed(index, len(inputs[0]))
            (k,) = inputs[0]
            return int(k)
        case "relate":
            related: Objects = facts.related[node.values[0]][inputs[0]]
            return related
        case "same":
            return facts.same(attribute, inputs[0])
        case "union":
            return frozenset(inputs[0] | inputs[1])
        case "intersect":
            return frozenset(inputs[0] & inputs[1])
        case "count":
            return len(inputs[0])
        case "exist":
            return bool(inputs[0])
        case "query":
            value: str = facts.values[attribute][inputs[0]]
            return value
        case "equal":
            return bool(inputs[0] == inputs[1])
        case "less":
            return bool(inputs[0] < inputs[1])
        case "greater":
            return bool(inputs[0] > inputs[1])
    raise AssertionError(node.function)
