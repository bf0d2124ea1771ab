"""Campaigns in this process: real jobs of a second each."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scene_attack.errors import Cancelled, InvalidRequest, JobFailure
from scene_attack.runs import campaign_run
from scene_attack.runs.adversary_dataset import AdversaryDataset, export
from scene_attack.runs.campaign_plan import CampaignResult, FirstAnswer, View, views, write
from scene_attack.runs.campaign_run import CampaignProgress, first_answer, first_answers, run_campaign
from scene_attack.runs.campaign_spec import CampaignSpec, parse
from scene_attack.runs.result import Result
from scene_attack.scenes.library import Library
from tests.unit.jobs.small import LIBRARY

pytestmark = pytest.mark.slow

GRID: dict[str, Any] = {
    "scenes": {"meshes": ["primitive/sphere"], "views": [0.61], "camera": {"size": [64, 64]}},
    "attacks": [
        {"name": "image", "attack": {"renderer": "image", "base_renderer": "pyrender", "steps": 8}},
        {"name": "colour", "attack": {"renderer": "pyrender", "groups": ["color"], "steps": 2}},
    ],
}


@pytest.fixture(scope="module")
def truth() -> str:
    """What the network says of the sphere, which these tests take for right."""
    [view] = views(parse({"grids": [GRID]}))
    label = first_answer(view, LIBRARY).label
    assert label is not None
    return label


@pytest.fixture(scope="module")
def campaign(truth: str) -> CampaignSpec:
    return parse({"name": "spheres", "grids": [GRID | {"goal": {"truth": truth}}]})


@pytest.fixture(scope="module")
def finished(campaign: CampaignSpec, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CampaignResult]:
    """The folder and the result of a campaign that nothing happened to."""
    out = tmp_path_factory.mktemp("campaign")
    return out, run_campaign(campaign, out, LIBRARY)


def results(out: Path) -> dict[str, Result]:
    """The results in a campaign's folder by the digest of their request."""
    found = {file.parent.name: file.read_bytes() for file in out.glob("jobs/*/result.json")}
    return {digest: Result.model_validate_json(data) for digest, data in found.items()}


def no_attack(*_: Any, **__: Any) -> None:
    raise AssertionError("no job had to run")


def test_its_table_says_what_its_results_say(finished: tuple[Path, CampaignResult], truth: str) -> None:
    out, found = finished
    [view] = found.views
    assert (view.chosen, view.label, view.truth, view.right) == (True, truth, [truth], True)
    image, colour = found.table.cells
    by_renderer = {str(one.spec["attack"]["renderer"]): one for one in results(out).values()}  # type: ignore[index]
    for cell, name in ((image, "image"), (colour, "pyrender")):
        result = by_renderer[name]
        won = result.outcome == "fooled" and result.verified
        assert (cell.ended, cell.success.of, cell.success.count) == (1, 1, int(won))
        assert cell.truncated == result.cost.truncated
        assert cell.perceptibility == (result.change.float_perceptibility if won else None)
        assert cell.by_queries == ([(result.cost.queries, 1)] if won else [])
        [curve] = [one for one in found.curves if one.attack == cell.attack]
        assert curve.loss == [row.loss for row in result.trace]
    assert image.success.count == 1  # the tests below have an adversary
    assert image.loop_perceptibility == by_renderer["image"].trace[-1].perceptibility


def test_the_files_of_its_table(finished: tuple[Path, CampaignResult], tmp_path: Path) -> None:
    written = write(finished[1], tmp_path)
    assert [path.name for path in written] == ["table.json", "table.csv", "table.tex", "curves.png"]
    assert CampaignResult.model_validate_json(written[0].read_bytes()) == finished[1]
    with Image.open(written[3]) as image:
        assert image.format == "PNG"
        assert np.asarray(image.convert("L")).std() > 5  # something is drawn


def test_run_again_it_has_nothing_left_to_do(
    finished: tuple[Path, CampaignResult], campaign: CampaignSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign_run, "execute", no_attack)
    assert run_campaign(campaign, finished[0], LIBRARY) == finished[1]


def test_a_run_that_was_stopped_goes_on_and_ends_in_the_same_results(
    finished: tuple[Path, CampaignResult], campaign: CampaignSpec, tmp_path: Path
) -> None:
    def ask() -> bool:
        nonlocal asked
        asked += 1
        return asked > 6  # in the middle of the first job

    asked = 0
    with pytest.raises(Cancelled):
        run_campaign(campaign, tmp_path, LIBRARY, cancelled=ask)
    assert results(tmp_path) == {}
    with (tmp_path / "first_answers.jsonl").open("a") as file:
        file.write('{"view": 1, "lab')  # the line that a killed process left behind
    phases: list[CampaignProgress] = []
    found = run_campaign(campaign, tmp_path, LIBRARY, progress=phases.append)
    assert not any(one.phase == "selecting" for one in phases)
    assert [(one.done, one.total) for one in phases] == [(0, 2), (1, 2), (2, 2)]
    assert found.table.cells[0].success == finished[1].table.cells[0].success
    assert found.curves == finished[1].curves
    for digest, other in results(finished[0]).items():
        name = f"jobs/{digest}/perturbation.safetensors"
        assert (tmp_path / name).read_bytes() == (finished[0] / name).read_bytes()
        assert results(tmp_path)[digest].cost.queries == other.cost.queries


def test_another_campaign_takes_the_results_unless_it_is_told_not_to(
    campaign: CampaignSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = run_campaign(campaign, tmp_path, LIBRARY)
    other = campaign.model_copy(update={"name": "other"})
    with monkeypatch.context() as patch:
        patch.setattr(campaign_run, "execute", no_attack)
        found = run_campaign(other, tmp_path, LIBRARY)
    assert [cell.reused for cell in found.table.cells] == [1, 1]
    assert [cell.success for cell in found.table.cells] == [cell.success for cell in first.table.cells]
    for file in tmp_path.glob("jobs/*/done.json"):
        file.write_text(json.dumps(json.loads(file.read_text()) | {"campaign": "another"}))
    found = run_campaign(other.model_copy(update={"reuse": False}), tmp_path, LIBRARY)
    assert [cell.reused for cell in found.table.cells] == [0, 0]


def test_a_failed_job_counts_as_no_success_and_is_tried_again(
    finished: tuple[Path, CampaignResult], campaign: CampaignSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise JobFailure("non-finite", "an image is not a number")

    with monkeypatch.context() as patch:
        patch.setattr(campaign_run, "execute", fail)
        found = run_campaign(campaign, tmp_path, LIBRARY)
    assert [(c.failed, c.success.of, c.success.count) for c in found.table.cells] == [(1, 1, 0)] * 2
    assert found.curves == []
    again = run_campaign(campaign, tmp_path, LIBRARY)
    assert [cell.success for cell in again.table.cells] == [cell.success for cell in finished[1].table.cells]


def test_a_view_without_its_truth_is_not_attacked(tmp_path: Path) -> None:
    found = run_campaign(parse({"grids": [GRID]}), tmp_path, LIBRARY)
    assert [view.why for view in found.views] == ["nobody knows its truth"]
    assert found.table.cells == []


def test_the_same_view_of_two_grids_is_asked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second grid has the first one's view and another."""
    other = GRID | {"scenes": GRID["scenes"] | {"views": [0.61, 1.0]}}
    every = views(parse({"grids": [GRID, other]}))
    assert [view.probe.scene.camera.azimuth for view in every] == [0.61, 0.61, 1.0]
    one_by_one = [first_answer(view, LIBRARY) for view in every]
    drawn: list[int] = []

    def counted(view: View, library: Library) -> FirstAnswer:
        drawn.append(view.number)
        return first_answer(view, library)

    monkeypatch.setattr(campaign_run, "first_answer", counted)
    assert list(first_answers(every, LIBRARY)) == one_by_one
    assert drawn == [0, 2]


def test_the_adversaries_are_a_maite_dataset(finished: tuple[Path, CampaignResult], truth: str, tmp_path: Path) -> None:
    from maite.protocols import image_classification as ic

    def given() -> Any:
        for digest, result in results(finished[0]).items():
            yield result, finished[0] / "jobs" / digest

    count = export(given(), tmp_path / "set", "spheres")
    dataset: ic.Dataset = AdversaryDataset(tmp_path / "set")
    assert isinstance(dataset, ic.Dataset)
    won = {d: r for d, r in results(finished[0]).items() if r.outcome == "fooled" and r.verified}
    assert len(dataset) == count == len(won)
    assert len(dataset.metadata["index2label"]) == 1000
    image, label, about = dataset[0]
    [digest] = [d for d, r in won.items() if r.attacked.label == about["answer"]][:1]  # type: ignore[typeddict-item]
    with Image.open(finished[0] / "jobs" / digest / "attacked.png") as file:
        pixels = np.asarray(file.convert("RGB"))
    assert np.array_equal(np.round(np.asarray(image).transpose(1, 2, 0) * 255).astype(np.uint8), pixels)
    assert dataset.metadata["index2label"][int(np.argmax(label))] == truth
    assert (about["id"], about["azimuth"]) == ("00000", 0.61)  # type: ignore[typeddict-item]
    with pytest.raises(InvalidRequest, match="is not empty"):
        export(given(), tmp_path / "set", "spheres")
    with pytest.raises(InvalidRequest, match="is no dataset"):
        AdversaryDataset(tmp_path)
