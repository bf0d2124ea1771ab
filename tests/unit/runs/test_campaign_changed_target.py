"""A campaign that is run again after one of its networks has changed under the same name."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from scene_attack.runs.campaign_plan import CampaignResult
from scene_attack.runs.campaign_run import run_campaign
from scene_attack.runs.campaign_spec import parse
from scene_attack.targets.classifier import Classifier
from scene_attack.targets.custom.loading import describe
from scene_attack.targets.registry import registered
from tests.unit.jobs.small import LIBRARY

CAMPAIGN: dict[str, Any] = {
    "scenes": {"meshes": ["primitive/sphere"], "views": [0.61, 1.2], "camera": {"size": [32, 32]}},
    "targets": ["one", "two"],
    "attacks": [{"name": "image", "attack": {"renderer": "image", "base_renderer": "pyrender", "steps": 1}}],
    "goal": {"truth": "bright"},
    "selection": {"right": False},
}


class Brightness(nn.Module):
    """Says that an image is bright if its mean is above `bound`."""

    def __init__(self, bound: float) -> None:
        super().__init__()
        self.bound = bound

    def forward(self, x: Tensor) -> Tensor:
        mean = x.mean((1, 2, 3))
        return torch.stack((mean - self.bound, self.bound - mean), 1)


@contextmanager
def networks(weights_of_two: str, bounds: tuple[float, float]) -> Iterator[None]:
    with ExitStack() as stack:
        for name, bound, weights in zip(("one", "two"), bounds, ("1" * 64, weights_of_two), strict=True):
            target = Classifier(
                name=name,
                network=Brightness(bound),
                labels=("bright", "dark"),
                input_size=(32, 32),
                mean=(0.0, 0.0, 0.0),
                std=(1.0, 1.0, 1.0),
                weights_sha256=weights,
                dtype=torch.float32,
            )
            stack.enter_context(registered(describe(name, target), target))
        yield


def cases(found: CampaignResult) -> list[int]:
    """The number of views that each target had right before the attack."""
    return [cell.success.of for cell in found.table.cells]


@pytest.mark.parametrize("weights", ["3" * 64, "2" * 64], ids=["other weights", "weights that nobody can hash"])
def test_results_of_the_network_that_was_there_before_are_not_counted(weights: str, tmp_path: Path) -> None:
    campaign = parse({"name": "changed", "grids": [CAMPAIGN]})
    with networks("2" * 64, (0.1, 0.1)):
        assert cases(run_campaign(campaign, tmp_path, LIBRARY)) == [2, 2]
    with networks(weights, (0.1, 0.9)):
        found = run_campaign(campaign, tmp_path, LIBRARY)
    assert [(view.target, view.right) for view in found.views] == [("one", True), ("two", False)] * 2
    assert cases(found) == [2, 0]


def test_results_of_a_network_that_nobody_can_hash_are_not_taken_by_another_campaign(tmp_path: Path) -> None:
    with networks("2" * 64, (0.1, 0.1)):
        run_campaign(parse({"name": "first", "grids": [CAMPAIGN]}), tmp_path, LIBRARY)
    with networks("2" * 64, (0.1, 0.11)):
        found = run_campaign(parse({"name": "second", "grids": [CAMPAIGN]}), tmp_path, LIBRARY)
    assert cases(found) == [2, 2]
    assert [cell.reused for cell in found.table.cells] == [2, 0]
