"""Whatever the project shows as an attack is on a scene that the network has right before."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.views import VIEWS
from scene_attack.runs.prepare import prepare
from scene_attack.runs.result import Result
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.targets.labels import truth_labels
from scene_attack.targets.registry import card
from scene_attack_service.settings import Settings
from scene_attack_worker.commands.demo import specs

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
CHECKED = ("already-wrong", "truth-unknown")
EXAMPLES = {path.name: json.loads(path.read_text()) for path in sorted((ROOT / "examples").glob("*.json"))}
REQUESTS: dict[str, dict[str, Any]] = {name: one for name, one in EXAMPLES.items() if "scene" in one} | {
    f"demo {number}": spec for number, spec in enumerate(specs())
}
"""Requests of one job. The other examples are campaigns, which select views that are right."""


@pytest.mark.parametrize("name", REQUESTS)
def test_a_job_of_the_demonstration_or_an_example_is_right_before(name: str) -> None:
    found = prepare(parse(REQUESTS[name]), Library(Settings().cache_dir, Settings().data_dir))
    assert [warning.text for warning in found.settled.warnings if warning.code in CHECKED] == []
    asked = REQUESTS[name].get("goal", {}).get("leave")
    assert asked is None or asked in (found.spec.goal.truth or ())


@pytest.mark.parametrize(("mesh", "label"), json.loads(VIEWS.read_text())["views"])
def test_the_label_of_a_view_that_a_report_counts_is_its_truth(mesh: str, label: str) -> None:
    """A report attacks only views to which the network answers this label."""
    assert label in truth_labels(card("efficientnet-lite0"), mesh)


def test_the_result_that_is_shown_first_is_a_success_that_was_right_before() -> None:
    result = Result.model_validate_json((ROOT / "docs/results/combined.json").read_text())
    assert (result.outcome, result.verified, result.verdict.right_before) == ("fooled", True, True)
    assert result.original.label in result.verdict.truth
    assert result.attacked.label not in result.verdict.truth
