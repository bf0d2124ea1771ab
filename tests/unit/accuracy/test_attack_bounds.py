"""The errors of images of whole attacks: short attacks on small scenes, and the committed report of the long ones."""

import json
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from benchmarks import attack_bounds
from benchmarks.attack_bounds import GROUPS, AttackErrors, adversarial_scenes, attack_errors, random_scenes
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack_accuracy.placing import library

pytestmark = pytest.mark.slow

REPORT = Path(__file__).parents[3] / "benchmarks" / "results" / "attack_bounds.json"


def test_scenes_are_the_same_every_time_and_go_through_all_groups() -> None:
    one, other = list(random_scenes(14)), list(random_scenes(14))
    assert one == other
    assert {case.groups for case in one} == set(GROUPS)
    assert one != list(random_scenes(14, seed=1))
    assert len({case.name for case in adversarial_scenes()}) == 16
    assert all("normals" in case.groups for case in adversarial_scenes())


@pytest.mark.parametrize("index", [0, 4])
def test_no_image_of_a_short_attack_is_beyond_the_estimate(index: int) -> None:
    [case] = islice(adversarial_scenes(), index, index + 1)
    found = attack_errors(case, library(), steps=6)
    assert found.table
    assert found.images == 7
    assert found.beyond == 0
    assert 0 < found.worst <= found.estimate <= case.tolerance


class Optimist(TorchRenderer):
    """A renderer whose plan promises too much."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.plan = self.plan.model_copy(update={"error": 1e-9})


def test_an_estimate_that_does_not_hold_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    [case] = islice(adversarial_scenes(), 4, 5)
    monkeypatch.setattr(attack_bounds, "TorchRenderer", Optimist)
    found = attack_errors(case, library(), steps=1)
    assert found.beyond == found.images == 2


class Spotted(TorchRenderer):
    """A renderer whose images are wrong by 0.2 in one value."""

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        spot = torch.zeros(*self.size, 3)
        spot[0, 0, 0] = 0.2
        return super().render(parameters) + (0.0 if self.plan.tolerance == "exact" else spot)


def test_the_error_of_an_image_is_that_of_its_worst_value() -> None:
    """The value is of the ground, where the renderer itself makes no error but that of float32."""
    [case] = islice(adversarial_scenes(), 4, 5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(attack_bounds, "TorchRenderer", Spotted)
        found = attack_errors(case, library(), steps=1)
    assert found.worst == pytest.approx(0.2, abs=1e-6)
    assert found.beyond == 2


def test_the_committed_report_says_that_no_image_was_beyond() -> None:
    report = json.loads(REPORT.read_text("utf-8"))
    rows = [AttackErrors.model_validate(row) for row in report["rows"]]
    assert len(rows) == report["summary"]["scenes"]
    assert report["summary"]["images"] == sum(row.images for row in rows)
    assert report["summary"]["images_beyond_estimate"] == sum(row.beyond for row in rows) == 0
    assert all(row.worst <= row.estimate <= row.tolerance for row in rows)
