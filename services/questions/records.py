"""CLEVR's question files: reads and writes them, keeping fields that are not CLEVR's."""

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, PlainValidator

from services.questions.answers import ANSWERS, kind_of
from services.questions.program import Program
from services.scenes.clevr.records import Info, Record


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
