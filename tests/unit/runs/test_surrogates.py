"""The surrogate of p-rgf in a request: what is refused, and the goal in its labels."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import parse
from scene_attack.targets import registry
from scene_attack.targets.info import TargetInfo
from tests.unit.attacks.small import LinearTarget
from tests.unit.jobs.small import LIBRARY

BALL = {"objects": [{"mesh": "furniture/soccer-ball"}], "camera": {"size": [96, 96]}}
FURNITURE = {"objects": [{"mesh": "furniture/couch"}], "camera": {"size": [96, 96]}}
PIXELS = {"renderer": "image", "base_renderer": "pyrender"}


def data(surrogate: str | None, **changes: Any) -> dict[str, Any]:
    given = PIXELS | {"method": "p-rgf", "surrogate": surrogate, "pairs": 2, "steps": 2}
    return {"scene": BALL, "attack": given} | changes


class Other(LinearTarget):
    """Sums of pixels for the labels it is given."""

    name = "other"

    def __init__(self, *labels: str) -> None:
        super().__init__(classes=len(labels))
        self.labels = labels

    def logits(self, images: torch.Tensor) -> torch.Tensor:
        return torch.stack([images.sum((1, 2, 3)) * (k + 1) for k in range(len(self.labels))], dim=1)


class Blind(Other):
    def logits(self, images: torch.Tensor) -> torch.Tensor:
        return super().logits(images.detach())


def card(of: Other) -> TargetInfo:
    return TargetInfo(
        name="other",
        title="sums of pixels",
        task="classification",
        input_size=(4, 5),
        classes=len(of.labels),
        differentiable=None,
        source="this test",
        licence="none",
    )


@contextmanager
def registered(target: Other) -> Iterator[None]:
    with registry.registered(card(target), target):
        yield


@pytest.mark.parametrize(
    ("surrogate", "said"),
    [
        ("alexnet-furnitur", "did you mean 'alexnet-furniture'"),
        ("efficientnet-lite0", "is the target itself"),
        ("alexnet-furniture", "none of the labels that the goal is to leave .soccer ball"),
    ],
)
def test_a_surrogate_that_cannot_guide_is_refused(surrogate: str, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said) as refused:
        prepare(parse(data(surrogate)), LIBRARY)
    assert refused.value.field == "attack.surrogate"


@pytest.mark.parametrize(
    ("target", "goal", "said"),
    [
        (Blind("soccer ball", "volleyball"), {}, "have no gradients"),
        (Other("soccer ball"), {}, "only the labels that the goal is to leave"),
        (Other("soccer ball", "volleyball"), {"reach": "tench"}, "has no label 'tench', which the goal is to reach"),
    ],
)
def test_one_of_a_persons_own_is_refused_for_the_same_reasons(target: Other, goal: dict[str, Any], said: str) -> None:
    with registered(target), pytest.raises(InvalidRequest, match=said) as refused:
        prepare(parse(data("other", goal=goal)), LIBRARY)
    assert refused.value.field == "attack.surrogate"


def test_the_goal_is_looked_up_by_name() -> None:
    with registered(Other("volleyball", "soccer ball", "tench")):
        found = prepare(parse(data("other")), LIBRARY)
        assert found.surrogate is not None
        assert (found.surrogate.goal.leave, found.surrogate.goal.reach) == ((1,), None)
        targeted = prepare(parse(data("other", goal={"reach": "tench"})), LIBRARY)
        assert targeted.surrogate is not None
        assert targeted.surrogate.goal.reach == 2
    assert prepare(parse(data(None)), LIBRARY).surrogate is None


def test_a_network_of_kinds_is_guided_by_one_of_imagenet_by_the_reviewed_table() -> None:
    given = data("efficientnet-lite0", scene=FURNITURE, target={"name": "alexnet-furniture"}, goal={"truth": "sofa"})
    found = prepare(parse(given), LIBRARY)
    assert found.surrogate is not None
    assert [found.surrogate.target.labels[index] for index in found.surrogate.goal.leave] == ["studio couch"]


def test_the_result_counts_the_surrogate_apart_and_names_its_weights(tmp_path: Any) -> None:
    with registered(Other("volleyball", "soccer ball")):
        result = execute(parse(data("other")), tmp_path, LIBRARY)
    assert result.verdict.stopped == "steps"
    assert result.cost.surrogate_queries == 2
    assert result.trace[-1].surrogate_queries == 2
    # the step's own image, the surrogate's direction and two others on both sides, twice; and the last image
    assert result.trace[-1].queries - result.trace[0].queries == 2 * (1 + 2 * 3)
    assert result.provenance.surrogate_sha256 == "0" * 64
