"""Text tables of questions: as a plan states them, and as a result answers them."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from rich.console import RenderableType
from rich.text import Text

from scene_attack.cli.console import FittedTable, answer_text, yes
from scene_attack.cli.tables import verdict
from scene_attack_questions.program import TYPE_WORDS, Program
from scene_attack_questions.records import Asked, QuestionResult, first_changed

TITLE = "Questions about the image"
ASKED_COLUMNS = ("question", "asks for", "right answer")
_ANSWERS = ("answer before", "answer after", "of that kind", "network")
ANSWERED_COLUMNS = ("question", "asks for", "right", "right after", *_ANSWERS)
ATTENTION_FILES = "attention-<question>-<function>-before.png and -after.png"


def asked_tables(questions: Sequence[Asked]) -> Iterator[RenderableType]:
    """Questions before an attack, e.g. those of a plan: each with its program and its right answer."""
    rows = [
        [_words(number, question), _asks_for(question), question.right] for number, question in enumerate(questions)
    ]
    yield FittedTable(ASKED_COLUMNS, rows, title=TITLE)
    yield from _lines(map(_program, questions))


def answered_tables(questions: Sequence[QuestionResult], folder: Path | None = None) -> Iterator[RenderableType]:
    """Questions and their answers before and after an attack. folder: that of the job's files, if it is here."""
    rows: list[list[str | Text]] = [
        [
            _words(number, question),
            _asks_for(question),
            question.right,
            question.right_after or "ill-posed",
            answer_text(question.before),
            answer_text(question.after),
            yes(question.before_of_kind) + Text(" → ") + yes(question.after_of_kind),
            verdict(question.outcome),
        ]
        for number, question in enumerate(questions)
    ]
    yield FittedTable(ANSWERED_COLUMNS, rows, title=TITLE)
    yield from _lines(f"{_program(question)}; {_changed(question)}" for question in questions)
    if folder is not None:
        yield f"Images of what the functions attend to: {folder / ATTENTION_FILES}"


def program_text(program: Program) -> str:
    """A program in a line, each function with its number and the numbers of those it takes.

    E.g. "0 scene, 1 filter_color[red](0), 2 count(1)".
    """
    return ", ".join(
        f"{number} {node.label}" + (f"({', '.join(map(str, node.inputs))})" if node.inputs else "")
        for number, node in enumerate(program.nodes)
    )


def _lines(programs: Iterable[str]) -> Iterator[str]:
    for number, line in enumerate(programs):
        yield f"Program of question {number}: {line}"


def _program(question: Asked) -> str:
    return program_text(Program.read(question.program))


def _changed(question: QuestionResult) -> str:
    first = first_changed(question.attention)
    if first is None:
        return "each function attends to the same objects after the attack"
    return f"function {first.node} is the first to attend to other objects after the attack"


def _words(number: int, question: Asked) -> str:
    return f"{number}  {question.question or '(given as a program)'}"


def _asks_for(question: Asked) -> str:
    return TYPE_WORDS[Program.read(question.program).types[-1]]
