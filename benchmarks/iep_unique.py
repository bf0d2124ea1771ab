"""Programs in which `unique` has a module of its own, in place of passing its input on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from services.questions.program import Program
from services.targets.iep.assembly import Assembly, Call, Level, Question, Slot
from services.targets.iep.vocabulary import KINDS, MAPPING, PLACES
from services.training.iep.examples import Example

UNIQUE = "unique as a module"
WITH_UNIQUE = PLACES | {"unique": ("mapping", len(MAPPING))}


@dataclass(frozen=True)
class _Applied:
    """A module applied to results, by number; -1 − i is `scene` of image i. depth: at least that of its inputs + 1."""

    module: str
    image: int
    inputs: tuple[int, ...]
    depth: int


def assemble_with_unique(questions: Sequence[Question]) -> Assembly:
    """Returns the network of a batch of questions. Levels are counted from the inputs; equal parts are found once."""
    numbers: dict[_Applied, int] = {}
    nodes = [_numbered(question, numbers) for question in questions]
    levels: dict[int, dict[str, list[_Applied]]] = {}
    for applied in numbers:
        level = levels.setdefault(applied.depth, {kind: [] for kind in KINDS})
        level[WITH_UNIQUE[applied.module][0]].append(applied)
    slots = {-1 - question.image: Slot(0, question.image, question.image) for question in questions}
    assembled, n_maps, n_vectors = [], 1, 0
    for _, kinds in sorted(levels.items()):
        assembled.append(Level(**{kind: tuple(_call(one, slots) for one in of) for kind, of in kinds.items()}))
        maps, vectors = kinds["mapping"] + kinds["joining"], kinds["reading"] + kinds["comparing"]
        slots |= {numbers[one]: Slot(n_maps, row, one.image) for row, one in enumerate(maps)}
        slots |= {numbers[one]: Slot(n_vectors, row, one.image) for row, one in enumerate(vectors)}
        n_maps, n_vectors = n_maps + bool(maps), n_vectors + bool(vectors)
    return Assembly(
        tuple(questions),
        1 + max(question.image for question in questions),
        tuple(assembled),
        tuple(tuple(slots[number] for number in of_question) for of_question in nodes),
    )


def named(example: Example) -> Example:
    """Returns an example whose `unique` has another name, so that the loss takes it for a module as any other."""
    nodes = (replace(node, function=UNIQUE) if node.function == "unique" else node for node in example.program.nodes)
    return replace(example, program=Program(tuple(nodes)))


def _numbered(question: Question, numbers: dict[_Applied, int]) -> list[int]:
    """Returns the number of each node's call; calls that are new are added to `numbers`."""
    found: list[int] = []
    depths: list[int] = []
    for node in question.program.nodes:
        depths.append(1 + max((depths[one] for one in node.inputs), default=-1))
        if node.function == "scene":
            found.append(-1 - question.image)
        else:
            applied = _Applied(node.label, question.image, tuple(found[one] for one in node.inputs), depths[-1])
            found.append(numbers.setdefault(applied, len(numbers)))
    return found


def _call(applied: _Applied, slots: dict[int, Slot]) -> Call:
    return Call(WITH_UNIQUE[applied.module][1], applied.image, tuple(slots[number] for number in applied.inputs))
