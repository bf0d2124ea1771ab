"""What the command line prints of jobs, and of questions about an image."""

from pathlib import Path
from typing import Any

import pytest

from scene_attack.analysis.records import Answer
from scene_attack.analysis.verdict import Verdict
from scene_attack.cli.tables import (
    goal_line,
    outcome_cell,
    print_answered,
    print_asked,
    program_text,
    successes,
    verified,
    warn,
)
from scene_attack.runs.result import Asked, Attended, JobWarning, Outcome, QuestionResult
from scene_attack_questions.executor import ANSWERS, KINDS
from scene_attack_questions.program import Node, Program
from tests.unit.client.scripted_service import SUCCEEDED


def line(outcome: str, right_before: bool | None, verified: bool = True, **fields: Any) -> Outcome:
    said = {"outcome": outcome, "fooled": True, "verified": verified, "right_before": right_before}
    return Outcome.model_validate(SUCCEEDED["outcome"] | said | fields)


def test_a_rate_counts_only_scenes_that_were_right_before() -> None:
    jobs = [
        line("fooled", True),
        line("held", True),
        line("held", True, verified=False),
        line("became-right", False),
        line("still-wrong", False),
        line("changed", None),
        line("held", None),
    ]
    assert successes(jobs).startswith("Fooled and verified: 1 of 3 attacks")
    assert successes([]).startswith("Fooled and verified: 0 of 0 attacks")


@pytest.mark.parametrize("word", ["fooled", "changed", "became-right", "still-wrong", "held"])
def test_the_word_of_a_job_is_its_outcome(word: str) -> None:
    assert outcome_cell(line(word, None)).plain == word


def test_a_search_that_held_says_that_its_epsilon_bound_it() -> None:
    bound = {"epsilon_bound": True, "float_perceptibility": 0.0213}
    limit = bound | {"perceptibility_limit": 0.05}
    assert outcome_cell(line("held", True, **bound)).plain == "held within ε"
    assert outcome_cell(line("held", True, **limit)).plain == "held within ε, p used 21.30 of 50.00 ×10⁻³"
    assert outcome_cell(line("held", True, **limit | {"epsilon_bound": False})).plain == "held"
    assert outcome_cell(line("fooled", True, **limit)).plain == "fooled"


@pytest.mark.parametrize(
    ("word", "shown"), [("fooled", "yes"), ("changed", "yes"), ("became-right", ""), ("still-wrong", "")]
)
def test_what_was_wrong_before_is_not_shown_as_verified(word: str, shown: str) -> None:
    assert verified(line(word, None)).plain == shown


def test_warnings_are_for_people_and_name_their_field(capsys: pytest.CaptureFixture[str]) -> None:
    warn([JobWarning(code="truth-unknown", field="goal.truth", text="nobody has said [bold]what[/bold]")])
    shown = capsys.readouterr()
    assert shown.err == "warning: goal.truth: nobody has said [bold]what[/bold]\n"
    assert shown.out == ""


def test_a_goal_is_stated_if_a_wrong_answer_may_not_meet_it() -> None:
    """Else a job that held, with a wrong answer beside it, reads as a mistake of the program."""
    assert goal_line({"goal": {"truth": ["4"], "leave": "4", "reach": None}}) is None
    assert "the answer '1'" in str(goal_line({"goal": {"leave": "4", "reach": "1"}}))
    assert "of another kind" in str(goal_line({"goal": {"reach": None, "leave_kind": True}}))


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
    print_answered([answered("no", "fooled"), answered("sphere", "held", None, None)], Path("out/x"))
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
    print_asked([asked])
    found = capsys.readouterr().out
    assert WORDS in found
    assert f"Program of question 0: {LINE}" in found
    print_asked([])
    print_answered([])
    assert capsys.readouterr().out == ""
