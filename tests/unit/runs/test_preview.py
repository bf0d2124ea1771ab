"""What a preview shows is what a job of the same request begins with."""

from typing import Any

import pytest
import torch

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.runs.prepare import plan, prepare
from scene_attack.runs.preview import planned_cost, preview
from scene_attack.targets.scores import probability
from tests.unit.jobs.small import LIBRARY, spec


@pytest.mark.parametrize("renderer", ["torch", "pyrender", "image"])
def test_it_shows_the_image_and_answers_that_a_job_begins_with(renderer: str) -> None:
    request = spec({"renderer": renderer})
    shown, image = preview(request, LIBRARY)
    job = prepare(request, LIBRARY)
    assert torch.equal(image, job.original.saved)
    [first] = shown.answers
    assert len(first.answer.top) == 5
    for label, value in first.answer.top:
        assert value == pytest.approx(float(probability(job.original.logits, job.target.labels.index(label))))
    assert first.answer.top[0][0] == first.answer.label == job.target.labels[int(job.original.logits.argmax())]
    assert (shown.spec, shown.warnings) == (job.spec, job.settled.warnings)


@pytest.mark.parametrize("renderer", [TorchRenderer, PyrenderRenderer])
def test_it_makes_no_plan(renderer: type[TorchRenderer | PyrenderRenderer], monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan takes longer than the image; its errors are measured when a renderer is asked for it."""

    def made(_: object) -> None:
        raise RuntimeError("a plan was made")

    monkeypatch.setattr(renderer, "plan", property(made))
    request = spec({"renderer": renderer.name}, scene={"camera": {"size": [64, 64], "azimuth": 0.7}})
    _, image = preview(request, LIBRARY)
    assert image.shape == (64, 64, 3)
    with pytest.raises(JobFailure, match=f"renderer '{renderer.name}' raised RuntimeError: a plan was made"):
        planned_cost(request, LIBRARY)


@pytest.mark.parametrize("groups", [TORCH.default_groups, *((group,) for group in TORCH.natural_groups)])
def test_the_plan_is_that_of_the_command_and_the_cost_counts_steps(groups: tuple[str, ...]) -> None:
    request = spec({"renderer": "torch", "groups": groups, "steps": 7, "queries": 90})
    found = planned_cost(request, LIBRARY)
    assert found.plan == plan(request, LIBRARY)
    assert found.plan.groups == groups
    cost = found.cost
    assert (cost.steps, cost.queries) == (7, 90)
    assert cost.least_seconds == pytest.approx(7 * (cost.image_seconds + cost.query_seconds))


@pytest.mark.parametrize(
    "changes",
    [
        {"scene": {"objects": [{"mesh": "primitive/sphere", "translation": [50, 0, 0]}]}},
        {"goal": {"leave": "grand piano"}},
        {"analysis": {"transfer": {"targets": ["no-such-network"]}}},
    ],
)
def test_a_request_that_cannot_run_is_refused_as_a_job_is(changes: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest) as of_job:
        prepare(spec(**changes), LIBRARY)
    with pytest.raises(InvalidRequest) as of_preview:
        preview(spec(**changes), LIBRARY)
    assert str(of_preview.value) == str(of_job.value)
