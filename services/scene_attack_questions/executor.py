"""Executes a question's program on the truth of a scene; lists the 28 answers and their kinds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from scene_attack.errors import InvalidRequest
from scene_attack.text import there_are
from scene_attack_questions.clevr.records import ATTRIBUTES, RELATIONS, SceneRecord
from scene_attack_questions.program import FUNCTIONS, Node, Program, Type

Objects = frozenset[int]
"""Indices of objects of a scene."""


@dataclass(frozen=True)
class Facts:
    """The truth about a scene. Objects are their indices in its record.

    `values[attribute][k]` is a value of object k, `having[attribute, value]` are the objects with a value, and
    `related[relation][k]` the objects that have a relation to object k.
    """

    everything: Objects
    values: dict[str, tuple[str, ...]]
    having: dict[tuple[str, str], Objects]
    related: dict[str, tuple[Objects, ...]]

    @classmethod
    def of(cls, record: SceneRecord) -> "Facts":
        """Returns the facts in a scene's record; relations are those that stand in it."""
        values = {name: tuple(thing.value(name) for thing in record.objects) for name in ATTRIBUTES}
        return cls(
            everything=frozenset(range(len(record.objects))),
            values=values,
            having={
                (name, value): frozenset(k for k, known_value in enumerate(values[name]) if known_value == value)
                for name, known in ATTRIBUTES.items()
                for value in known
            },
            related={name: tuple(frozenset(row) for row in record.relationships[name]) for name in RELATIONS},
        )

    def same(self, attribute: str, k: int) -> Objects:
        """Returns the other objects that share object k's value of an attribute."""
        return self.having[attribute, self.values[attribute][k]] - {k}


MAX_COUNT = 10
"""Largest number that is an answer."""

KINDS: dict[Type, tuple[str, ...]] = {
    "boolean": ("yes", "no"),
    "integer": tuple(str(n) for n in range(MAX_COUNT + 1)),
    "shape": ATTRIBUTES["shape"],
    "size": ATTRIBUTES["size"],
    "color": ATTRIBUTES["color"],
    "material": ATTRIBUTES["material"],
}
"""The answers of each kind; a kind is a type that a program may end in."""

ANSWERS: tuple[str, ...] = tuple(answer for kind in KINDS.values() for answer in kind)
"""All answers. Networks score them in this order."""

_KIND_OF = {answer: kind for kind, answers in KINDS.items() for answer in answers}


def kind_of(answer: str) -> Type:
    """Returns the kind of an answer. Raises InvalidRequest("answer") if it is none."""
    if answer not in _KIND_OF:
        raise InvalidRequest("answer", f"there is no answer {answer!r}; {there_are(answer, ANSWERS)}")
    return _KIND_OF[answer]


def kind_asked(program: Program) -> Type:
    """Returns the kind of answer that a valid program asks for."""
    return FUNCTIONS[program.nodes[-1].function].output


Value = Objects | int | bool | str
"""A node's output: a set or the index of an object, a number, a truth value, or a value of an attribute."""


class IllPosed(InvalidRequest):
    """A program asks for the one object of a set that has none or many. `node` is its `unique`, `found` the number."""

    def __init__(self, node: int, found: int) -> None:
        count_words = "there is none" if found == 0 else f"there are {found}"
        super().__init__(
            f"program.{node}", f"unique asks for the only object, and {count_words}: the question is ill-posed"
        )
        self.node = node
        self.found = found

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.node, self.found)


def answer(program: Program, facts: Facts) -> str:
    """Returns the answer to a question. Raises as `execute` does, and InvalidRequest for a count that is no answer."""
    result = execute(program, facts)[-1]
    if isinstance(result, bool):
        return "yes" if result else "no"
    if isinstance(result, int) and result > MAX_COUNT:
        raise InvalidRequest("program", f"the answer is {result}; numbers above {MAX_COUNT} are no answers")
    return str(result)


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
