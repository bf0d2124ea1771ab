"""The case that a job becomes in a campaign's table, from a stored result with figures that differ from one another."""

import json
from pathlib import Path
from typing import Any

import pytest

from scene_attack.runs.campaign_plan import PlannedJob, case_of, curves_of
from scene_attack.runs.result import Result
from scene_attack.runs.spec import JobSpec
from tests.unit.api.dashboard_records import with_fields

STORED = json.loads((Path(__file__).parents[3] / "docs/results/combined.json").read_text())
PLANNED = PlannedJob("t", "a", True, None, "", 0, JobSpec.model_validate(STORED["spec"]))


def result(**changed: Any) -> Result:
    return Result.model_validate(with_fields(STORED, **changed))


def test_a_case_has_the_papers_p_and_that_of_the_loop_at_the_stored_step() -> None:
    stored = result(step=1, truncated=17, float_perceptibility=0.00251)
    case = case_of(PLANNED, stored, run_seconds=3.0)
    assert stored.trace[1].perceptibility != stored.trace[-1].perceptibility
    assert case.loop_perceptibility == stored.trace[1].perceptibility
    assert case.perceptibility == 0.00251 != stored.change.perceptibility
    assert (case.truncated, case.queries) == (17, stored.cost.queries)
    assert (case.seconds, case.run_seconds) == (stored.cost.seconds, 3.0)
    assert curves_of(stored).advantage == [row.advantage for row in stored.trace]
    assert curves_of(stored).loss == [row.loss for row in stored.trace]


@pytest.mark.parametrize(
    ("changed", "right", "success", "loop_success"),
    [
        ({"outcome": "fooled", "right_before": True, "fooled": True, "verified": True}, True, True, True),
        ({"outcome": "held", "right_before": True, "fooled": True, "verified": False}, True, False, True),
        ({"outcome": "held", "right_before": True, "fooled": False, "verified": False}, True, False, False),
        ({"outcome": "still-wrong", "right_before": False, "fooled": True, "verified": True}, False, False, False),
        ({"outcome": "became-right", "right_before": False, "fooled": True, "verified": True}, False, False, False),
        ({"outcome": "changed", "right_before": None, "fooled": True, "verified": True}, False, False, False),
    ],
)
def test_only_a_network_that_was_right_is_fooled_verified_or_in_the_loop(
    changed: dict[str, Any], right: bool, success: bool, loop_success: bool
) -> None:
    case = case_of(PLANNED, result(**changed))
    assert (case.right, case.success, case.loop_success) == (right, success, loop_success)
