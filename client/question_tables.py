"""Prints questions (services.pipeline.question_record): their programs and, after an attack, their answers."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from client.console import answer_text, out, table, yes
from client.outcomes import verdict

Questions = Sequence[Mapping[str, Any]]
"""Records of questions as JSON data."""


def print_asked(questions: Questions) -> None:
    """Prints questions before an attack, e.g. those of a plan: each with its program and its right answer."""
    if questions:
        columns = ("question", "asks for", "right answer")
        rows = [[_words(one, number), one["kind"], one["right"]] for number, one in enumerate(questions)]
        _print(table(columns, rows, title="Questions about the image"), questions)


def print_answered(questions: Questions, folder: Path | None = None) -> None:
    """Prints questions and their answers before and after an attack. folder: that of the job's files, if it is here."""
    if not questions:
        return
    columns = (
        "question",
        "asks for",
        "right",
        "right after",
        "answer before",
        "answer after",
        "of that kind",
        "network",
    )
    rows: list[list[str | Text]] = [
        [
            _words(one, number),
            one["kind"],
            one["right"],
            one["right_after"] or "ill-posed",
            answer_text(one["before"]),
            answer_text(one["after"]),
            _of_kind(one),
            verdict({"outcome": one["outcome"]}),
        ]
        for number, one in enumerate(questions)
    ]
    _print(table(columns, rows, title="Questions about the image"), questions)
    if folder is not None and any(one["attention"] for one in questions):
        name = "attention-<question>-<function>-before.png and -after.png"
        out().print(f"Where the functions attend: {folder / name}", markup=False, highlight=False, soft_wrap=True)


def _print(made: Table, questions: Questions) -> None:
    console = out()
    console.print(made)
    for number, one in enumerate(questions):
        line = f"Program of question {number}: {program_text(one['program'])}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def program_text(program: Iterable[Mapping[str, Any]]) -> str:
    """A program in a line, each function with its number and the numbers of those it takes.

    E.g. "0 scene, 1 filter_color[red](0), 2 count(1)".
    """
    return ", ".join(f"{number} {_call(call)}" for number, call in enumerate(program))


def _call(call: Mapping[str, Any]) -> str:
    values = f"[{', '.join(call['value_inputs'])}]" if call["value_inputs"] else ""
    inputs = f"({', '.join(map(str, call['inputs']))})" if call["inputs"] else ""
    return f"{call['function']}{values}{inputs}"


def _words(question: Mapping[str, Any], number: int) -> str:
    return f"{number}  {question['question'] or '(given as a program)'}"


def _of_kind(question: Mapping[str, Any]) -> Text:
    """Whether the answers before and after are of the kind that is asked for."""
    return yes(question["before_of_kind"]) + Text(" → ") + yes(question["after_of_kind"])
