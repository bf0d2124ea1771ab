"""Assembles the programs of a batch of questions into one network: the modules that run together, and the results that
they take.

Nodes are put on levels counted from the roots: a root is on level 0, and an input is on a higher level than all that
take it. A level's nodes depend on higher levels only, so all nodes of a level that are of the same kind run as one
batch, whatever their functions. Equal subprograms of questions about the same image are computed once.

A module is a function with its value, named as a program's node is: `filter_color[red]` and `filter_color[blue]` have
weights of their own. `scene` is computed once for an image, and `unique` passes its input on; neither has a module
here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from scene_attack_questions.program import FUNCTIONS, Program

MAPPED = ("set", "object")
"""Types of results that are a map, a mask over the image. All others are a vector, with scores over the answers."""


def _modules(n_inputs: int, takes_maps: bool, gives_map: bool) -> tuple[str, ...]:
    return tuple(
        f"{name}[{value}]" if value else name
        for name, function in FUNCTIONS.items()
        if name != "unique"
        and len(function.inputs) == n_inputs
        and all((kind in MAPPED) == takes_maps for kind in function.inputs)
        and (function.output in MAPPED) == gives_map
        for value in function.values or ("",)
    )


MAPPING = _modules(1, takes_maps=True, gives_map=True)
"""Modules from a map to a map: `filter_*`, `relate`, `same_*`."""
JOINING = _modules(2, takes_maps=True, gives_map=True)
"""Modules from two maps to a map: `union`, `intersect`."""
READING = _modules(1, takes_maps=True, gives_map=False)
"""Modules from a map to a vector: `count`, `exist`, `query_*`."""
COMPARING = _modules(2, takes_maps=False, gives_map=False)
"""Modules from two vectors to a vector: `equal_*`, `less_than`, `greater_than`."""

KINDS = {"mapping": MAPPING, "joining": JOINING, "reading": READING, "comparing": COMPARING}
PLACES = {name: (kind, place) for kind, names in KINDS.items() for place, name in enumerate(names)}
"""The kind of each module, and its place in the list of its kind."""


@dataclass(frozen=True)
class Question:
    """A program, and the index in the batch of the image that it is about."""

    program: Program
    image: int = 0


@dataclass(frozen=True)
class Slot:
    """The place of a result: a row of a stack of results, about an image of the batch.

    Stack 0 of the maps is `scene` of each image. All others are numbered in the order in which they are computed.
    """

    stack: int
    row: int
    image: int


@dataclass(frozen=True)
class Call:
    """A module applied to earlier results about an image. place: the module's in the list of its kind."""

    place: int
    image: int
    inputs: tuple[Slot, ...]


@dataclass(frozen=True)
class Level:
    """The calls of a level, by kind.

    Its maps, those of `mapping` before those of `joining`, are a new stack of maps. Its vectors, those of `reading`
    before those of `comparing`, are a new stack of vectors. A stack without rows is not numbered.
    """

    mapping: tuple[Call, ...]
    joining: tuple[Call, ...]
    reading: tuple[Call, ...]
    comparing: tuple[Call, ...]


@dataclass(frozen=True)
class Assembly:
    """A network assembled from modules.

    n_images: the images that the batch must have. levels: in the order in which they run. slots: for each question that
    of each node's result, in the maps if it is a set or an object, else in the vectors.
    """

    questions: tuple[Question, ...]
    n_images: int
    levels: tuple[Level, ...]
    slots: tuple[tuple[Slot, ...], ...]


@dataclass(frozen=True)
class _Applied:
    """A call whose inputs are numbers of other calls; -1 − i is `scene` of image i."""

    module: str
    image: int
    inputs: tuple[int, ...]


def assemble(questions: Sequence[Question]) -> Assembly:
    """Returns the network of a batch of questions.

    Raises InvalidProgram for the first invalid program, and ValueError for a negative image or no question.
    """
    if not questions or min(question.image for question in questions) < 0:
        raise ValueError("an assembly needs a question at least, and images are numbered from 0")
    numbers: dict[_Applied, int] = {}
    nodes = [_numbered(question, numbers) for question in questions]
    calls = list(numbers)
    levels = _levels(calls)
    by_level: list[dict[str, list[int]]] = [{kind: [] for kind in KINDS} for _ in range(max(levels) + 1)]
    for number, (call, level) in enumerate(zip(calls, levels, strict=True)):
        by_level[level][PLACES[call.module][0]].append(number)
    slots = {-1 - question.image: Slot(0, question.image, question.image) for question in questions}
    assembled = []
    n_maps, n_vectors = 1, 0
    for kinds in reversed(by_level):
        assembled.append(Level(**{kind: tuple(_call(calls[n], slots) for n in kinds[kind]) for kind in kinds}))
        maps, vectors = kinds["mapping"] + kinds["joining"], kinds["reading"] + kinds["comparing"]
        slots |= {number: Slot(n_maps, row, calls[number].image) for row, number in enumerate(maps)}
        slots |= {number: Slot(n_vectors, row, calls[number].image) for row, number in enumerate(vectors)}
        n_maps, n_vectors = n_maps + bool(maps), n_vectors + bool(vectors)
    return Assembly(
        tuple(questions),
        1 + max(question.image for question in questions),
        tuple(assembled),
        tuple(tuple(slots[number] for number in of_question) for of_question in nodes),
    )


def _numbered(question: Question, numbers: dict[_Applied, int]) -> list[int]:
    """Returns the number of each node's call; calls that are new are added to `numbers`."""
    question.program.check()
    calls: list[int] = []
    for node in question.program.nodes:
        if node.function == "scene":
            calls.append(-1 - question.image)
        elif node.function == "unique":
            calls.append(calls[node.inputs[0]])
        else:
            applied = _Applied(node.label, question.image, tuple(calls[place] for place in node.inputs))
            calls.append(numbers.setdefault(applied, len(numbers)))
    return calls


def _levels(calls: Sequence[_Applied]) -> list[int]:
    """Returns the level of each call; inputs come before the calls that take them."""
    levels = [0] * len(calls)
    for number in range(len(calls) - 1, -1, -1):
        for source in calls[number].inputs:
            if source >= 0:
                levels[source] = max(levels[source], levels[number] + 1)
    return levels


def _call(applied: _Applied, slots: dict[int, Slot]) -> Call:
    return Call(PLACES[applied.module][1], applied.image, tuple(slots[number] for number in applied.inputs))
