"""What the command line prints of jobs."""

from typing import Any

import pytest

from scene_attack.cli.tables import (
    goal_line,
    outcome_cell,
    successes,
    verified,
    warn,
)
from scene_attack.runs.result import JobWarning, Outcome
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


@pytest.mark.questions
def test_a_goal_is_stated_if_a_wrong_answer_may_not_meet_it() -> None:
    """Else a job that held, with a wrong answer beside it, reads as a mistake of the program."""
    assert goal_line({"goal": {"truth": ["4"], "leave": "4", "reach": None}, "target": {"name": "iep"}}) is None
    assert "the answer '1'" in str(goal_line({"goal": {"leave": "4", "reach": "1"}}))
    assert "of another kind" in str(
        goal_line({"goal": {"reach": None}, "target": {"name": "iep", "ask": {"leave_kind": True}}})
    )
