"""Analyses that a request asks for, on real jobs of a second or two."""

from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from scene_attack.analysis.records import AnalysisRequest, RerenderingRequest
from scene_attack.errors import Cancelled, InvalidRequest
from scene_attack.rendering.factory import build
from scene_attack.runs.analyse import analyse_stored, rerender_image
from scene_attack.runs.execute import Progress, execute
from scene_attack.runs.prepare import prepare
from scene_attack.runs.result import Result
from scene_attack.scenes.resolve import resolve
from tests.unit.jobs.small import LIBRARY, spec

pytestmark = pytest.mark.slow

IMAGE_ANALYSIS: dict[str, Any] = {
    "minimal": {"scans": 4, "bisections": 3},
    "coordinates": {},
    "transfer": {"targets": ["efficientnet-lite0"]},
    "interpretation": {"steps": 2},
    "rerendering": {"steps": 3},
}


def test_a_job_makes_the_analyses_that_it_names_and_a_stored_result_gives_the_same(tmp_path: Path) -> None:
    seen: list[Progress] = []
    job = spec({"renderer": "image"}, analysis=IMAGE_ANALYSIS)
    result = execute(job, tmp_path, LIBRARY, progress=seen.append)
    assert Result.model_validate_json((tmp_path / "result.json").read_text()) == result
    made = result.analyses
    assert made.minimal is not None
    assert made.minimal.smallest is not None
    assert made.minimal.smallest.scale <= 1
    assert made.coordinates is not None
    assert made.coordinates.parts == ["image"]  # pixels have no names
    assert made.transfer is not None
    assert made.transfer[0].before.label == result.original.label
    assert made.transfer[0].after.label == result.attacked.label
    assert made.transfer[0].outcome == result.outcome
    assert made.interpretation is not None
    assert [(one.optimiser, one.rate) for one in made.interpretation.fits] == [
        (name, rate) for name in ("sgd", "adam") for rate in (1e-3, 1e-4, 1e-5)
    ]
    assert made.interpretation.image.label == result.attacked.label
    assert made.interpretation.scene.label == result.original.label
    assert all(len(one.losses) == 3 for one in made.interpretation.fits)
    assert made.rerendering is not None
    assert made.rerendering.before.label == result.attacked.label
    names = list(dict.fromkeys(one.analysis for one in seen if one.analysis is not None))
    assert names == ["minimal", "transfer", "interpretation", "rerendering"]  # one coordinate needs no image
    assert all(one.step < one.steps for one in seen if one.analysis is not None)
    again = analyse_stored(tmp_path, AnalysisRequest.model_validate(IMAGE_ANALYSIS), LIBRARY, lambda *_: None)
    assert again.analyses == made
    assert again.attribution == result.attribution
    assert again.subsets == result.subsets


def test_p_before_rounding_is_that_of_the_stored_pixels(tmp_path: Path) -> None:
    result = execute(spec({"renderer": "image", "steps": 2}), tmp_path, LIBRARY)
    change = load_file(tmp_path / "perturbation.safetensors")["image"].double()
    assert float(change.abs().max()) > 0
    # float32 holds a pixel of 0.5 + 0.002 to 3e-8, 1.5e-5 of the step
    assert result.change.float_perceptibility == pytest.approx(float(change.square().sum(-1).mean().sqrt()), rel=5e-5)
    # changes of 0.51/255 and 1.48/255 are saved as 1/255
    assert abs(result.change.float_perceptibility / result.change.perceptibility - 1) > 0.05


def test_shapley_values_of_a_job_sum_to_its_effect(tmp_path: Path) -> None:
    result = execute(spec({"renderer": "torch"}), tmp_path, LIBRARY)
    found = result.attribution
    assert found is not None
    assert found.parts == ["normals", "illumination", "material"]
    effect = result.attacked.goal_probability - result.original.goal_probability
    assert sum(found.probability.shapley) == pytest.approx(effect, abs=1e-6)
    assert found.log_odds.effect == pytest.approx(sum(found.log_odds.shapley), abs=1e-6)
    assert found.log_odds.effect < 0


def test_poses_are_carried_to_the_other_renderer_and_words_are_physical(tmp_path: Path) -> None:
    attack = {"renderer": "pyrender", "groups": ["color", "rotation"], "delta": 1e-2, "steps": 2}
    analysis = {"second_opinion": {"renderers": ["torch"]}, "minimal": {"scans": 1, "bisections": 0}}
    job = spec(attack, scene={"objects": [{"mesh": "primitive/cube"}]}, analysis=analysis)
    result = execute(job, tmp_path, LIBRARY)
    moved = load_file(tmp_path / "perturbation.safetensors")
    thing = job.scene.objects[0].model_copy(
        update={
            "rotation": tuple(moved["rotation"][0].tolist()),
            "color": tuple((1 + moved["color"][0]).tolist()),
        }
    )
    changed = build(resolve(job.scene.model_copy(update={"objects": (thing,)}), LIBRARY), "torch", tolerance="exact")
    image = (changed.render({g: v[None] for g, v in changed.initial().items()})[0] * 255).round() / 255
    target = prepare(job, LIBRARY).target
    probabilities = target.logits(image[None].float()).softmax(dim=-1)[0]
    assert result.analyses.second_opinion is not None
    [found] = result.analyses.second_opinion
    assert found.after is not None
    assert found.before is not None
    assert found.after.label == target.labels[int(probabilities.argmax())]
    assert found.after.confidence == pytest.approx(float(probabilities.max()), abs=1e-4)
    assert (found.note, found.share, found.failure) == ("", None, None)
    own = build(resolve(job.scene, LIBRARY), "torch", tolerance="exact")
    unmoved = (own.render({g: v[None] for g, v in own.initial().items()})[0] * 255).round() / 255
    first = target.logits(unmoved[None].float()).softmax(dim=-1)[0]
    assert found.before.confidence == pytest.approx(float(first.max()), abs=1e-4)  # of the renderer that drew it
    assert result.analyses.minimal is not None
    words = {(one.group, one.measure, one.unit): one.value for one in result.analyses.minimal.stored_change}
    angle = float(torch.rad2deg(moved["rotation"][0].norm()))
    assert words[("rotation", "angle", "degrees")] == pytest.approx(angle, rel=1e-6)


def test_a_truth_that_is_stated_is_carried_by_name(tmp_path: Path) -> None:
    """The table knows nothing of a sphere; the network is shown to itself, and judged as in the job."""
    transfer = {"transfer": {"targets": ["efficientnet-lite0"]}}
    result = execute(
        spec({"renderer": "image", "steps": 1}, goal={"truth": "tench"}, analysis=transfer), tmp_path, LIBRARY
    )
    assert result.analyses.transfer is not None
    [found] = result.analyses.transfer
    assert (
        (found.right_before, found.outcome) == (result.verdict.right_before, result.outcome) == (False, "still-wrong")
    )


def test_a_truth_is_not_carried_by_name_to_a_vocabulary_of_other_meaning(tmp_path: Path) -> None:
    """Of a coffee cup the kind is "cup". ImageNet has a "cup" too, but its reviewed answers are more than that."""
    scene = {"objects": [{"mesh": "furniture/coffee-cup"}], "camera": {"size": [96, 96]}}
    attack = {"renderer": "image", "base_renderer": "pyrender", "steps": 1}
    transfer = {"transfer": {"targets": ["efficientnet-lite0"]}}
    job = spec(attack, scene=scene, target={"name": "alexnet-furniture"}, analysis=transfer)
    result = execute(job, tmp_path, LIBRARY)
    assert (result.verdict.truth, result.verdict.right_before) == (["cup"], True)
    assert result.analyses.transfer is not None
    [found] = result.analyses.transfer
    assert found.before.label == "espresso"  # which the table has as right for this mesh
    assert found.right_before is True


def test_a_cancelled_job_stops_within_an_analysis(tmp_path: Path) -> None:
    analysing: list[str] = []
    with pytest.raises(Cancelled):
        execute(
            spec({"renderer": "image"}, analysis={"rerendering": {"steps": 10_000}}),
            tmp_path,
            LIBRARY,
            progress=lambda p: analysing.append(p.analysis) if p.analysis else None,
            cancelled=lambda: len(analysing) >= 2,
        )
    assert analysing == ["rerendering", "rerendering"]


@pytest.mark.parametrize(
    ("attack", "renderer", "said"),
    [
        ({"renderer": "pyrender"}, "pyrender", "the attack itself"),
        ({"renderer": "pyrender"}, "torhc", "torch"),
        ({"renderer": "pyrender"}, "image", "no renderer 'image' that draws a scene"),
        ({"renderer": "torch"}, "pyrender", "nothing of normals"),
        ({"renderer": "pyrender", "groups": ["illumination"]}, "torch", "nothing of"),
        ({"renderer": "image"}, "pyrender", "nothing of image"),
    ],
)
def test_an_opinion_that_cannot_be_had_is_refused_before_the_job(
    attack: dict[str, Any], renderer: str, said: str
) -> None:
    with pytest.raises(InvalidRequest) as refused:
        prepare(spec(attack, analysis={"second_opinion": {"renderers": [renderer]}}), LIBRARY)
    assert refused.value.field == "analysis.second_opinion.renderers.0"
    assert said in refused.value.detail


def test_an_unknown_network_is_refused_before_the_job() -> None:
    with pytest.raises(InvalidRequest, match=r"^analysis.transfer.targets.0: .*efficientnet-lite0"):
        prepare(spec({"renderer": "image"}, analysis={"transfer": {"targets": ["efficientnet-lite"]}}), LIBRARY)


@pytest.mark.parametrize(
    ("analysis", "field"),
    [
        ({"transfer": {}}, "analysis.transfer.targets"),
        ({"second_opinion": {"renderers": []}}, "analysis.second_opinion.renderers"),
        ({"minimal": {"scans": 0}}, "analysis.minimal.scans"),
        ({"coordinates": {"images": 3}}, "analysis.coordinates.images"),
        ({"rerendering": {"optimiser": "lbfgs"}}, "analysis.rerendering.optimiser"),
        ({"shapley": {}}, "analysis.shapley"),
    ],
)
def test_a_bad_analysis_is_named(analysis: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        spec(analysis=analysis)
    assert refused.value.field == field


def test_the_defence_of_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="32×16 pixels; the camera of the scene has 64×64"):
        rerender_image(
            torch.zeros(16, 32, 3, dtype=torch.uint8), spec(), RerenderingRequest(), LIBRARY, lambda *_: None
        )


def test_the_scenes_own_image_is_its_own_rendering() -> None:
    """Nothing to explain: the fit starts at a distance of rounding, and ends at the same label and image."""
    original = prepare(spec({"renderer": "torch"}), LIBRARY).original.saved
    found, rendered = rerender_image(original, spec(), RerenderingRequest(steps=2), LIBRARY, lambda *_: None)
    assert found.losses[0] < 0.5 / 255
    assert found.before.label == found.after.label
    assert (rendered.int() - original.int()).abs().max() <= 1
