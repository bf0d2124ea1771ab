"""One attack, judged by what is said to be right: the perturbation is the same, the outcome is not."""

from pathlib import Path
from typing import Any

import pytest

from scene_attack.runs.execute import execute
from scene_attack.runs.result import JobWarning, Result, success
from tests.unit.jobs.small import LIBRARY, spec

ATTACK = {"renderer": "image", "base_renderer": "pyrender", "steps": 12, "learning_rate": {"image": 0.01}}


def run(out: Path, **goal: Any) -> Result:
    return execute(spec(ATTACK, goal=goal), out, LIBRARY)


@pytest.fixture(scope="module")
def unknown(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """Of a sphere nobody has said what it is."""
    return run(tmp_path_factory.mktemp("unknown"))


def test_without_a_truth_the_answer_has_changed(unknown: Result) -> None:
    assert (unknown.outcome, unknown.verified, unknown.verdict.right_before, unknown.verdict.truth) == (
        "changed",
        True,
        None,
        [],
    )
    assert "truth-unknown" in [warning.code for warning in unknown.warnings]
    assert unknown.verdict.leave == unknown.original.label in unknown.verdict.labels_to_leave
    assert unknown.attacked.label not in unknown.verdict.labels_to_leave
    assert not success(unknown)


def test_an_answer_that_was_right_was_fooled(unknown: Result, tmp_path: Path) -> None:
    found = run(tmp_path, truth=unknown.original.label)
    assert (found.outcome, found.verdict.right_before, found.attacked) == ("fooled", True, unknown.attacked)
    assert success(found)


def test_an_answer_that_was_wrong_became_right_or_is_still_wrong(unknown: Result, tmp_path: Path) -> None:
    said: list[JobWarning] = []
    for truth, outcome in ((unknown.attacked.label, "became-right"), ("grand piano", "still-wrong")):
        job = spec(ATTACK, goal={"truth": truth})
        found = execute(job, tmp_path / outcome, LIBRARY, checked=lambda _, found: said.extend(found))
        assert (found.outcome, found.verdict.right_before, found.attacked) == (outcome, False, unknown.attacked)
        assert found.verified, "the goal, to leave the first answer, is met"
        assert not success(found)
        assert found.warnings[0].code == "already-wrong"
    assert [warning.code for warning in said].count("already-wrong") == 2


def test_an_answer_that_is_as_right_is_left_too(unknown: Result, tmp_path: Path) -> None:
    """The attack that found it before has to find another."""
    right = {unknown.original.label, unknown.attacked.label}
    found = run(tmp_path, truth=sorted(right))
    assert right <= set(found.verdict.labels_to_leave)
    assert found.outcome in ("fooled", "held")
    assert (found.attacked.label in right) == (found.outcome == "held")
    assert found.attacked != unknown.attacked


def test_a_new_answer_below_the_least_confidence_does_not_meet_the_goal(unknown: Result, tmp_path: Path) -> None:
    least = (1 + unknown.attacked.confidence) / 2
    found = run(tmp_path, least_confidence=least)
    assert found.attacked != unknown.attacked
    assert (found.attacked.confidence >= least) == (found.outcome == "changed")
