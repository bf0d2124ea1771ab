"""Generates questions about scenes, balanced over families, functions and answers, in the form of CLEVR's files."""

from collections import Counter
from collections.abc import Iterator, Sequence
from random import Random
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, PlainValidator

from services.questions.executor import ANSWERS, Facts, answer, kind_of
from services.questions.program import Program
from services.questions.templates.families import FAMILIES, Family, Filled
from services.questions.templates.search import build, instances
from services.questions.templates.wording import word
from services.scenes.clevr.records import Info, Record, SceneRecord


def _answer(value: object) -> object:
    """CLEVR's generator writes truth values and numbers as such; its published files have words."""
    if isinstance(value, bool):
        value = "yes" if value else "no"
    elif isinstance(value, int):
        value = str(value)
    if isinstance(value, str) and value not in ANSWERS:
        kind_of(value)
    return value


def _program(value: object) -> Program:
    return value if isinstance(value, Program) else Program.read(value)


def _written(program: Program) -> list[dict[str, Any]]:
    return program.written()


Answer = Annotated[str, BeforeValidator(_answer)]
WrittenProgram = Annotated[Program, PlainValidator(_program), PlainSerializer(_written)]


class QuestionRecord(Record):
    """A question about an image. CLEVR's test questions have neither answer nor program nor family.

    A program that was read has the form of CLEVR's; whether it is valid is for `Program.check` to say.
    `question_family_index` is an index into `templates.families.FAMILIES` in files made here; official files count
    CLEVR's own templates.
    """

    split: str
    image_index: int
    image_filename: str
    question: str
    question_index: int | None = None
    question_family_index: int | None = None
    answer: Answer | None = None
    program: WrittenProgram | None = None


class QuestionFile(Record):
    """A file of questions."""

    info: Info
    questions: tuple[QuestionRecord, ...]


TRIES = 8
"""Questions of a family that are drawn in a scene until one has an answer given no more often than the mean."""

_INDEX = {family: index for index, family in enumerate(FAMILIES)}


class QuestionGenerator:
    """Asks questions about one scene after another.

    The families asked least often come first: by their kind, then by what they ask, then each by itself. Of TRIES
    questions of a family, the one is taken whose answer was given least often to the same function in families of the
    same kind. The questions depend on `seed`, on `families` (those that may be asked), and on the scenes so far.
    """

    def __init__(self, seed: int, families: Sequence[Family] = FAMILIES) -> None:
        self._seed = seed
        self._families = tuple(families)
        self._asked: Counter[object] = Counter()
        self._answers: dict[tuple[str, str], Counter[str]] = {}
        self._count = 0

    def ask(self, scene: SceneRecord, count: int) -> list[QuestionRecord]:
        """Returns up to `count` different questions about a scene, of different families as long as there are some.

        There are fewer if the search finds no more that are well-posed and not degenerate.
        """
        random = Random(f"questions/{self._seed}/{scene.split}/{scene.image_index}")
        facts = Facts.of(scene)
        records: dict[Program, QuestionRecord] = {}
        before = -1
        while before < len(records) < count:
            before = len(records)
            for family in self._in_turn(random):
                question = self._question(family, facts, random)
                if question is None or question[1] in records:
                    continue
                records[question[1]] = self._record(scene, family, *question, random)
                if len(records) == count:
                    break
        return list(records.values())

    def _in_turn(self, random: Random) -> Iterator[Family]:
        """Yields each family once, each time the one that was asked least often of those that are left."""
        left = list(self._families)
        random.shuffle(left)
        while left:
            family = min(left, key=self._often)
            left.remove(family)
            yield family

    def _often(self, family: Family) -> tuple[int, int, int]:
        return self._asked[family.kind], self._asked[family.kind, family.asks], self._asked[family]

    def _question(self, family: Family, facts: Facts, random: Random) -> tuple[tuple[Filled, ...], Program, str] | None:
        answers = self._answers.setdefault((family.kind, family.asks), Counter())
        best: tuple[tuple[Filled, ...], Program, str] | None = None
        for _ in range(TRIES):
            phrases = next(instances(family, facts, random), None)
            if phrases is None:
                break
            program = build(family, phrases)
            question = phrases, program, answer(program, facts)
            if best is None or answers[question[2]] < answers[best[2]]:
                best = question
            if answers[best[2]] * len(answers) <= answers.total():
                break
        return best

    def _record(
        self,
        scene: SceneRecord,
        family: Family,
        phrases: tuple[Filled, ...],
        program: Program,
        answer_text: str,
        random: Random,
    ) -> QuestionRecord:
        self._answers[family.kind, family.asks][answer_text] += 1
        self._asked.update((family.kind, (family.kind, family.asks), family))
        self._count += 1
        return QuestionRecord(
            split=scene.split,
            image_index=scene.image_index,
            image_filename=scene.image_filename,
            question_index=self._count - 1,
            question_family_index=_INDEX[family],
            question=word(family, phrases, random),
            answer=answer_text,
            program=program,
        )
