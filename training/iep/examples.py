"""Training data of the parts of IEP: objects in images, and questions with the true result of every node."""

from dataclasses import dataclass
from functools import cached_property

from scene_attack_questions.clevr.records import ATTRIBUTES, ObjectRecord
from scene_attack_questions.executor import Facts, Value, execute
from scene_attack_questions.families import FAMILIES
from scene_attack_questions.generator import QuestionRecord
from scene_attack_questions.iep.engine import GRID, STRIDE
from scene_attack_questions.program import Program, Type

Result = tuple[int, ...] | str
"""The true result of a node: the indices of the objects of a set or of one object, else a word of the answers."""


@dataclass(frozen=True)
class ObjectTruth:
    """An object in an image. row, column: its centre in pixels. attributes: name to value, of all four."""

    row: float
    column: float
    attributes: dict[str, str]

    @classmethod
    def of(cls, record: ObjectRecord) -> "ObjectTruth":
        """The truth in an object's record."""
        column, row, _ = record.pixel_coords
        return cls(row, column, {name: record.value(name) for name in ATTRIBUTES})

    @cached_property
    def cell(self) -> int:
        """The feature cell that holds its centre; the nearest one for a centre outside the image."""
        height, width = GRID
        row, column = (int(place // STRIDE) for place in (self.row, self.column))
        return min(max(row, 0), height - 1) * width + min(max(column, 0), width - 1)


@dataclass(frozen=True)
class Example:
    """A question about an image.

    image: its index. text: the question. results: of each node of the program; the last is the answer.
    family: the kind of question, by which accuracy is reported.
    """

    image: int
    text: str
    program: Program
    results: tuple[Result, ...]
    family: str

    @classmethod
    def of(cls, image: int, question: QuestionRecord, facts: Facts) -> "Example":
        """A question that was made here about a scene with these facts, with its program and its family.

        Raises as `execute` does.
        """
        assert question.program is not None
        assert question.question_family_index is not None
        outputs = zip(question.program.types, execute(question.program, facts), strict=True)
        results = tuple(_result(kind, output) for kind, output in outputs)
        family = FAMILIES[question.question_family_index].kind
        return cls(image, question.question, question.program, results, family)

    @property
    def answer(self) -> str:
        """The right answer."""
        assert isinstance(self.results[-1], str)
        return self.results[-1]


def _result(kind: Type, output: Value) -> Result:
    if isinstance(output, frozenset):
        return tuple(sorted(output))
    if kind == "object":
        assert isinstance(output, int)
        return (output,)
    return {True: "yes", False: "no"}[output] if isinstance(output, bool) else str(output)
