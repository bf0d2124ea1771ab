"""What the command line prints of questions about an image."""

from pathlib import Path

import pytest

from scene_attack.analysis.records import Answer
from scene_attack.analysis.verdict import Verdict
from scene_attack.cli.tables import print_tasks
from scene_attack_questions.executor import ANSWERS, KINDS
from scene_attack_questions.parts import QuestionsPlan, QuestionsResult
from scene_attack_questions.program import Node, Program
from scene_attack_questions.records import Asked, Attended, QuestionResult
from scene_attack_questions.tables import program_text

WORDS = "Is there a cube to the left of the red thing?"
SAME = Program(
    (
        Node("scene", (), ()),
        Node("filter_color", (0,), ("red",)),
        Node("unique", (1,), ()),
        Node("relate", (2,), ("left",)),
        Node("filter_shape", (3,), ("cube",)),
        Node("exist", (4,), ()),
    )
)
LINE = "0 scene, 1 filter_color[red](0), 2 unique(1), 3 relate[left](2), 4 filter_shape[cube](3), 5 exist(4)"


def said(label: str, confidence: float) -> Answer:
    index = ANSWERS.index(label)
    return Answer(label=label, index=index, confidence=confidence, goal_probability=0, top=[(label, confidence)])


def answered(
    after: str, outcome: Verdict, right_after: str | None = "yes", words: str | None = WORDS
) -> QuestionResult:
    after_of_kind = after in KINDS["boolean"]
    attended = {"before": "attention-0-00-before.png", "after": "attention-0-00-after.png"}
    return QuestionResult(
        question=words,
        program=SAME.written(),
        kind="boolean",
        right="yes",
        right_after=right_after,
        before=said("yes", 0.97),
        after=said(after, 0.61),
        before_of_kind=True,
        after_of_kind=after_of_kind,
        outcome=outcome,
        attention=[
            Attended(node=node, change=change, cell_change=change, **attended)
            for node, change in ((0, 0.0), (1, 0.3), (2, after_of_kind * 0.9))
        ],
    )


def test_a_program_is_a_line() -> None:
    assert program_text(SAME) == LINE


def test_a_question_is_printed_with_its_answers_and_flagged_if_they_are_of_another_kind(
    capsys: pytest.CaptureFixture[str],
) -> None:
    results = QuestionsResult(questions=[answered("no", "fooled"), answered("sphere", "held", None, None)])
    print_tasks({"questions": results}, Path("out/x"))
    lines = capsys.readouterr().out.splitlines()
    first, second = ([cell.strip() for cell in line.split("│")[1:-1]] for line in lines if "0.97" in line)
    assert first == [f"0  {WORDS}", "yes or no", "yes", "yes", "yes 0.97", "no 0.61", "yes → yes", "fooled"]
    assert second[0] == "1  (given as a program)"
    assert second[3:] == ["ill-posed", "yes 0.97", "sphere 0.61", "yes → no", "held"]
    programs = [line for line in lines if line.startswith("Program of question")]
    assert programs == [
        f"Program of question 0: {LINE}; function 2 is the first to attend to other objects after the attack",
        f"Program of question 1: {LINE}; each function attends to the same objects after the attack",
    ]
    assert any("out/x/attention-" in line for line in lines)


def test_a_question_of_a_plan_is_printed_without_answers(capsys: pytest.CaptureFixture[str]) -> None:
    asked = Asked(question=WORDS, program=SAME.written(), kind="boolean", right="yes")
    print_tasks({"questions": QuestionsPlan(questions=(asked,))})
    found = capsys.readouterr().out
    assert WORDS in found
    assert f"Program of question 0: {LINE}" in found
    print_tasks({})
    print_tasks({"of a plug-in that is not installed": {"questions": []}})
    assert capsys.readouterr().out == ""
