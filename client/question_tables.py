"""Prints questions (services.pipeline.question_record): their programs and, after an attack, their answers."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.text import Text

from client.console import answer_text, out, table, yes
from client.fitted_table import FittedTable
from client.outcomes import verdict
from services.pipeline.question_record import Asked, QuestionResult, first_changed
from services.questions.program import TYPE_WORDS, Program

TITLE = "Questions about the image"
ASKED = ("question", "asks for", "right answer")
ANSWERED = ("question", "asks for", "right", "right after", "answer before", "answer after", "of that kind", "network")
ATTENTION_FILES = "attention-<question>-<function>-before.png and -after.png"


def print_asked(questions: Sequence[Asked]) -> None:
    """Prints questions before an attack, e.g. those of a plan: each with its program and its right answer."""
    if questions:
        rows = [[_words(number, one), _asks_for(one), one.right] for number, one in enumerate(questions)]
        _print(table(ASKED, rows, title=TITLE), map(_program, questions))


def print_answered(questions: Sequence[QuestionResult], folder: Path | None = None) -> None:
    """Prints questions and their answers before and after an attack. folder: that of the job's files, if it is here."""
    if not questions:
        return
    rows: list[list[str | Text]] = [
        [
            _words(number, one),
            _asks_for(one),
            one.right,
            one.right_after or "ill-posed",
            answer_text(one.before),
            answer_text(one.after),
            yes(one.before_of_kind) + Text(" → ") + yes(one.after_of_kind),
            verdict(one.outcome),
        ]
        for number, one in enumerate(questions)
    ]
    lines = [f"{_program(one)}; {_changed(one)}" for one in questions]
    _print(table(ANSWERED, rows, title=TITLE), lines)
    if folder is not None:
        line = f"Images of what the functions attend to: {folder / ATTENTION_FILES}"
        out().print(line, markup=False, highlight=False, soft_wrap=True)


def program_text(program: Program) -> str:
    """A program in a line, each function with its number and the numbers of those it takes.

    E.g. "0 scene, 1 filter_color[red](0), 2 count(1)".
    """
    return ", ".join(
        f"{number} {node.label}" + (f"({', '.join(map(str, node.inputs))})" if node.inputs else "")
        for number, node in enumerate(program.nodes)
    )


def _print(made: FittedTable, lines: Iterable[str]) -> None:
    console = out()
    console.print(made)
    for number, line in enumerate(lines):
        console.print(f"Program of question {number}: {line}", markup=False, highlight=False, soft_wrap=True)


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
