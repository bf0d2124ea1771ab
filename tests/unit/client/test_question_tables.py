"""What the command line prints of questions."""

from pathlib import Path
from typing import Any

import pytest

from client.question_tables import print_answered, print_asked, program_text
from services.analysis.records import Answer
from services.attacks.verdict import Verdict
from services.pipeline.question_record import Asked, Attended, QuestionResult
from services.questions.answers import ANSWERS, KINDS
from tests.unit.targets.iep.seeded import SAME, TAUGHT

WORDS = next(words for words, program in TAUGHT.items() if program == SAME)
LINE = "0 scene, 1 filter_color[red](0), 2 unique(1), 3 relate[left](2), 4 filter_shape[cube](3), 5 exist(4)"


def said(label: str, confidence: float) -> Answer:
    index = ANSWERS.index(label)
    return Answer(label=label, index=index, confidence=confidence, goal_probability=0, top=[(label, confidence)])


def answered(after: str, outcome: Verdict, right_after: str | None = "yes", words: str | None = WORDS) -> Any:
    return QuestionResult(
        question=words,
        program=SAME.written(),
        kind="boolean",
        right="yes",
        right_after=right_after,
        before=said("yes", 0.97),
        after=said(after, 0.61),
        before_of_kind=True,
        after_of_kind=after in KINDS["boolean"],
        outcome=outcome,
        attention=[Attended(node=0, before="attention-0-00-before.png", after="attention-0-00-after.png")],
    ).model_dump()


def test_a_program_is_a_line() -> None:
    assert program_text(SAME.written()) == LINE


def test_a_question_is_printed_with_its_answers_and_flagged_if_they_are_of_another_kind(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_answered([answered("no", "fooled"), answered("sphere", "held", None, None)], Path("out/x"))
    lines = capsys.readouterr().out.splitlines()
    first, second = ([cell.strip() for cell in line.split("│")[1:-1]] for line in lines if "0.97" in line)
    assert first == [f"0  {WORDS}", "boolean", "yes", "yes", "yes 0.97", "no 0.61", "yes → yes", "fooled"]
    assert second[0] == "1  (given as a program)"
    assert second[3:] == ["ill-posed", "yes 0.97", "sphere 0.61", "yes → no", "held"]
    assert f"Program of question 0: {LINE}" in lines
    assert f"Program of question 1: {LINE}" in lines
    assert any("out/x/attention-" in line for line in lines)


def test_a_question_of_a_plan_is_printed_without_answers(capsys: pytest.CaptureFixture[str]) -> None:
    asked = Asked(question=WORDS, program=SAME.written(), kind="boolean", right="yes")
    print_asked([asked.model_dump()])
    found = capsys.readouterr().out
    assert WORDS in found
    assert f"Program of question 0: {LINE}" in found
    print_asked([])
    print_answered([])
    assert capsys.readouterr().out == ""
