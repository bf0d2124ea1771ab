"""Outcomes of results, among them those that earlier versions stored."""

import pytest

from services.pipeline.outcome import Outcome, outcome, success
from services.pipeline.result import Result
from tests.unit.api.dashboard_records import result

NEW = ("outcome", "truth", "right_before", "labels_to_leave", "warnings")


def old(**changed: object) -> dict[str, object]:
    """A result without the fields that earlier versions did not write."""
    return {name: value for name, value in (result() | changed).items() if name not in NEW}


@pytest.mark.parametrize(("verified", "word"), [(True, "changed"), (False, "held")])
def test_a_result_of_an_earlier_version_is_read_and_is_no_success(verified: bool, word: str) -> None:
    found = Result.model_validate(old(verified=verified))
    assert (found.outcome, found.truth, found.right_before, found.warnings) == (word, [], None, [])
    line = {name: value for name, value in outcome(found).items() if name not in NEW}
    assert Outcome.model_validate(line).outcome == word
    assert not success(found)
    assert not success(Outcome.model_validate(line))


@pytest.mark.parametrize("word", ["fooled", "changed", "became-right", "still-wrong", "held"])
@pytest.mark.parametrize("verified", [True, False])
def test_only_a_verified_fooled_counts_as_a_success(word: str, verified: bool) -> None:
    found = Result.model_validate(result(outcome=word, verified=verified))
    assert success(found) == success(Outcome.model_validate(outcome(found))) == (word == "fooled" and verified)
