"""Outcomes of results, and the functions of a question whose attention changed."""

import pytest

from scene_attack.runs.result import Attended, Outcome, Result, first_changed, most_changed, outcome, success
from tests.unit.api.dashboard_records import result


@pytest.mark.parametrize("word", ["fooled", "changed", "became-right", "still-wrong", "held"])
@pytest.mark.parametrize("verified", [True, False])
def test_only_a_verified_fooled_counts_as_a_success(word: str, verified: bool) -> None:
    found = Result.model_validate(result(outcome=word, verified=verified))
    assert success(found) == success(Outcome.model_validate(outcome(found))) == (word == "fooled" and verified)


def attention(*changes: tuple[float, float]) -> list[Attended]:
    """Functions 3, 4, … whose attention changed by so much, and at a cell."""
    return [
        Attended(node=3 + k, before="", after="", change=change, cell_change=at_a_cell)
        for k, (change, at_a_cell) in enumerate(changes)
    ]


def test_the_first_change_is_the_first_at_a_cell() -> None:
    """Many small changes of cells are not another object."""
    found = first_changed(attention((0.1, 0.1), (6.0, 0.49), (0.5, 0.5), (2.0, 0.9)))
    assert found is not None
    assert found.node == 5
    assert first_changed(attention((9.0, 0.49))) is None
    assert first_changed([]) is None


def test_the_largest_change_is_the_first_of_equal_ones() -> None:
    found = most_changed(attention((0.1, 0.1), (2.0, 0.4), (0.3, 0.3), (2.0, 0.9)))
    assert found is not None
    assert found.node == 4
    assert most_changed(attention((0.0, 0.0), (0.0, 0.0))) is None
    assert most_changed([]) is None
