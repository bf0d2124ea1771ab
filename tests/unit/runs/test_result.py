"""Outcomes of results."""

import pytest

from scene_attack.runs.result import Outcome, Result, outcome, success
from tests.unit.api.dashboard_records import result


@pytest.mark.parametrize("word", ["fooled", "changed", "became-right", "still-wrong", "held"])
@pytest.mark.parametrize("verified", [True, False])
def test_only_a_verified_fooled_counts_as_a_success(word: str, verified: bool) -> None:
    found = Result.model_validate(result(outcome=word, verified=verified))
    assert success(found) == success(Outcome.model_validate(outcome(found))) == (word == "fooled" and verified)
