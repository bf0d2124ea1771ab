"""Requests for campaigns: what is refused and by which name, and the views and jobs of what is not."""

import json
from copy import deepcopy
from math import pi
from pathlib import Path
from typing import Any

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.runs.campaign_plan import jobs, views
from scene_attack.runs.campaign_spec import CampaignSpec, RandomViews, SceneGrid, parse
from scene_attack.runs.check import check_size, most_jobs, placed, samples, uploads_in
from scene_attack.scenes import furniture
from scene_attack.targets import registry
from scene_attack.targets.labels import truth_labels

IMAGE = {"name": "image", "attack": {"renderer": "image"}}
NORMALS = {"name": "normals", "attack": {"renderer": "torch", "groups": ["normals"]}}
POSE = {"name": "pose", "attack": {"renderer": "pyrender", "groups": ["rotation"]}}
SPEC: dict[str, Any] = {
    "name": "c",
    "grids": [
        {
            "scenes": {"meshes": ["primitive/sphere", "primitive/cube"], "views": [0.1, 0.2]},
            "targets": ["efficientnet-lite0"],
            "attacks": [IMAGE, NORMALS, POSE],
            "seeds": [0, 1],
        }
    ],
}


def changed(**values: Any) -> dict[str, Any]:
    spec = deepcopy(SPEC)
    spec["grids"][0] |= values
    return spec


@pytest.mark.parametrize(
    ("data", "field", "words"),
    [
        ({}, "grids", "needs a grid, or jobs"),
        ({"grids": [{"attacks": [IMAGE]}]}, "grids.0.scenes", "is required, or `generate`"),
        (changed(scenes={}), "grids.0.scenes.meshes", "name at least one mesh"),
        (changed(scenes={"kinds": ["chairs"]}), "grids.0.scenes.kinds", "did you mean 'chair'"),
        (changed(scenes={"meshes": ["a"], "views": {"random": 0}}), "grids.0.scenes.views.random", "from 1 to 1000"),
        (changed(scenes={"meshes": ["a"], "views": [7.0]}), "grids.0.scenes.views.0", "from -2π to 2π"),
        (changed(attacks=[]), "grids.0.attacks", "a list of 1 to 64"),
        (changed(attacks=[IMAGE, IMAGE]), "grids.0.attacks.1.name", "already"),
        (changed(attacks=[{"name": "a", "attack": {"method": "fgsmm"}}]), "grids.0.attacks.0.attack.method", "fgsm"),
        (changed(targets=["a", "b", "a"]), "grids.0.targets.2", "the same as entry 0"),
        (changed(seeds=[0, 0]), "grids.0.seeds.1", "the same as entry 0"),
        (changed(scenes={"meshes": ["a"], "views": [0.1, 0.1]}), "grids.0.scenes.views.1", "the same as entry 0"),
        (changed(scenes=[{"objects": [{"mesh": "a"}]}] * 2), "grids.0.scenes.1", "the same as entry 0"),
        (
            {"grids": [*SPEC["grids"], SPEC["grids"][0] | {"attacks": [IMAGE | {"attack": {"steps": 3}}]}]},
            "grids.1.attacks.0.name",
            "an earlier grid has a column 'image' for efficientnet-lite0 with another attack",
        ),
        (SPEC | {"name": "\x1b[2J"}, "name", "U+001B"),
        (changed(attacks=[IMAGE | {"name": "a\nb"}]), "grids.0.attacks.0.name", "U+000A"),
        (changed(targets=[3]), "grids.0.targets.0", "an object"),
        (changed(selection={"per_class": 0}), "grids.0.selection.per_class", "at least 1"),
        (changed(seeds=[-1]), "grids.0.seeds.0", "from 0"),
        (changed(sceness=[]), "grids.0.sceness", "no such field"),
        ({"jobs": [{"scene": {"objects": []}}]}, "jobs.0.scene.objects", "a list of 1 to 16"),
    ],
)
def test_a_bad_request_names_its_field(data: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        parse(data)
    assert refused.value.field == field
    assert words in refused.value.detail


def test_the_stored_request_is_the_same_request() -> None:
    spec = parse(SPEC)
    assert CampaignSpec.model_validate(spec.model_dump(mode="json")) == spec


def test_views_are_scenes_by_target_and_renderer_of_the_image() -> None:
    found = views(parse(SPEC))
    assert [view.number for view in found] == list(range(8))
    about = [(v.probe.scene.objects[0].mesh, v.probe.scene.camera.azimuth, v.image_renderer) for v in found]
    # the first view of every mesh comes before the second of any
    assert about[:4] == [
        ("primitive/sphere", 0.1, "torch"),
        ("primitive/sphere", 0.1, "pyrender"),
        ("primitive/cube", 0.1, "torch"),
        ("primitive/cube", 0.1, "pyrender"),
    ]
    assert about[4][:2] == ("primitive/sphere", 0.2)


def test_jobs_are_those_of_the_chosen_views_only() -> None:
    spec = parse(SPEC)
    found = views(spec)
    planned = list(jobs(spec, [found[3], found[4]], {}))
    assert [(job.view, job.attack, job.spec.seed) for job in planned] == [
        (3, "pose", 0),
        (3, "pose", 1),
        (4, "image", 0),
        (4, "image", 1),
        (4, "normals", 0),
        (4, "normals", 1),
    ]
    assert planned[2].spec.scene == found[4].probe.scene
    assert planned[2].spec.attack.renderer == "image"


def test_single_jobs_are_run_as_they_are() -> None:
    job = {"scene": {"objects": [{"mesh": "primitive/cube"}]}, "attack": {"renderer": "image"}, "seed": 3}
    spec = parse({"jobs": [job]})
    [view] = views(spec)
    assert view.selection is None
    [planned] = jobs(spec, [view], {})
    assert (planned.attack, planned.target, planned.spec) == ("image fgsm", "efficientnet-lite0", spec.jobs[0])


def test_random_views_are_a_meshs_own() -> None:
    few = SceneGrid(meshes=("a", "b"), views=RandomViews(random=400, seed=1))
    many = SceneGrid(meshes=("c", "b", "a"), views=RandomViews(random=400, seed=1))
    assert few.azimuths("a") == many.azimuths("a") != few.azimuths("b")
    assert SceneGrid(meshes=("a",), views=RandomViews(random=400, seed=2)).azimuths("a") != few.azimuths("a")
    drawn = sorted(few.azimuths("a"))
    assert drawn[0] >= 0
    assert drawn[-1] < pi
    # Kolmogorov's statistic against the uniform distribution; 1.63/√n is its 1 % point
    assert max(abs((i + 0.5) / 400 - a / pi) for i, a in enumerate(drawn)) < 1.63 / 20


def test_the_azimuths_are_the_same_on_every_machine() -> None:
    grid = SceneGrid(meshes=("furniture/couch",), views=RandomViews(random=2, seed=0))
    assert grid.azimuths("furniture/couch") == (0.2011730819025787, 2.67593349673745)


def test_kinds_take_turns() -> None:
    grid = SceneGrid(meshes=("primitive/cube",), kinds=("chair", "sofa"), per_kind=2)
    chairs, sofas = (furniture.kinds()[kind] for kind in ("chair", "sofa"))
    assert grid.mesh_names() == ("primitive/cube", chairs[0], sofas[0], chairs[1], sofas[1])


def test_a_campaign_over_the_limit_is_refused() -> None:
    check_size(parse(SPEC), 24)  # 4 scenes × 3 attacks × 2 seeds
    with pytest.raises(InvalidRequest, match="grids: the campaign may have 24 jobs, and the limit is 23"):
        check_size(parse(SPEC), 23)
    check_size(parse(changed(selection={"most": 1})), 8)
    with pytest.raises(InvalidRequest, match="asks the networks for 8 views, and the limit is 7"):
        check_size(parse(changed(selection={"most": 1})), 7)
    huge = {"kinds": list(furniture.kinds()), "views": {"random": 1000}}
    with pytest.raises(InvalidRequest, match="limit is 10,000"):
        check_size(parse(changed(scenes=huge)), 10_000)


def test_a_campaign_that_is_long_once_its_defaults_are_filled_in_is_refused() -> None:
    """Forty readers of a request of 1 MB, 10 MB with its defaults, took the service 4 GB."""
    job = {"scene": {"objects": [{"mesh": "primitive/sphere"}]}, "attack": {}}
    check_size(parse({"jobs": [job] * 1000}))
    with pytest.raises(InvalidRequest, match=r"jobs: .* takes \d\.\d MB, and the limit is 2 MB; make .* by grids"):
        check_size(parse({"jobs": [job] * 3000}))


def test_every_upload_is_named_by_its_first_place() -> None:
    mesh, other, light = (f"sha256:{digit * 64}" for digit in "123")
    lights = {"environment": {"map": light}}
    listed = [{"objects": [{"mesh": "primitive/sphere"}]}, {"objects": [{"mesh": other}], "lights": lights}]
    grids = changed(scenes={"meshes": ["primitive/cube", mesh], "kinds": ["chair"], "lights": lights})["grids"]
    spec = parse({"grids": [*grids, *changed(scenes=listed)["grids"]], "jobs": [{"scene": scene} for scene in listed]})
    assert uploads_in(spec) == {
        mesh: "grids.0.scenes.meshes.1",
        light: "grids.0.scenes.lights.environment.map",
        other: f"grids.{len(grids)}.scenes.1.objects.0.mesh",
    }
    assert uploads_in(parse({"jobs": [{"scene": scene} for scene in listed]})) == {
        light: "jobs.1.scene.lights.environment.map",
        other: "jobs.1.scene.objects.0.mesh",
    }


@pytest.mark.parametrize(
    ("field", "place"),
    [
        ("attack.method", "grids.0.attacks.1.attack.method"),
        ("target.name", "grids.0.targets.0.name"),
        ("scene.objects.0.material", "grids.0.scenes.material"),
        ("scene.objects.0", "grids.0.scenes.camera"),
        ("scene.lights.environment.map", "grids.0.scenes.lights.environment.map"),
        ("goal.reach", "grids.0.goal.reach"),
    ],
)
def test_an_error_of_a_sample_is_named_by_its_place(field: str, place: str) -> None:
    kinds = list(samples(parse(SPEC)))
    assert [job.attack.renderer for job, _ in kinds] == ["image", "torch", "pyrender"]
    assert placed(InvalidRequest(field, "d"), kinds[1][1]).field == place


def test_an_attack_whose_bounds_differ_is_checked_of_its_own() -> None:
    bounded = {"name": "b", "attack": IMAGE["attack"] | {"bounds": {"image": [0.9, 1.0]}}}
    more = {"name": "c", "attack": IMAGE["attack"] | {"steps": 3}}
    checked = [job.attack for job, _ in samples(parse(changed(attacks=[IMAGE, bounded, more])))]
    assert [one.bounds for one in checked] == [{}, {"image": (0.9, 1.0)}]


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("campaign-small", 27),
        ("paper-differentiable", 1400),
        ("paper-lite0", 360),
        ("paper-physical", 1480),
        ("paper-physical-lite0", 700),
        ("paper-pose", 120),
        ("paper-around", 234),
        ("paper-one-look-alexnet", 800),
        ("paper-one-look-resnet34", 800),
        ("paper-equal-p", 520),
        ("paper-nondifferentiable", 210),
        ("paper-tolerances", 120),
        ("paper-vqa-differentiable", 520),
        ("paper-vqa-nondifferentiable", 24),
    ],
)
def test_the_examples_are_requests_within_the_limit(name: str, most: int) -> None:
    file = Path(__file__).parents[3] / "examples" / f"{name}.json"
    campaign = parse(json.loads(file.read_text("utf-8")))
    check_size(campaign)
    assert most_jobs(campaign) == most


@pytest.mark.parametrize("name", ["differentiable", "nondifferentiable"])
def test_the_papers_tables_attack_models_that_no_network_was_trained_on(name: str) -> None:
    root = Path(__file__).parents[3]
    split = json.loads((root / "training" / "split.json").read_text("utf-8"))
    held_out = {f"{furniture.PREFIX}{slug}" for kind in split["classes"] for slug in split["held_out"][kind]}
    campaign = parse(json.loads((root / "examples" / f"paper-{name}.json").read_text("utf-8")))
    for grid in campaign.grids:
        assert isinstance(grid.scenes, SceneGrid)
        assert set(grid.scenes.mesh_names()) == held_out


def test_the_paper_campaign_of_lite0_attacks_meshes_whose_truth_was_reviewed() -> None:
    root = Path(__file__).parents[3]
    campaign = parse(json.loads((root / "examples" / "paper-lite0.json").read_text("utf-8")))
    small, large = campaign.grids
    assert isinstance(small.scenes, SceneGrid)
    assert isinstance(large.scenes, SceneGrid)
    assert small.scenes.mesh_names() == large.scenes.mesh_names()
    lite0 = registry.card("efficientnet-lite0")
    assert all(truth_labels(lite0, mesh) for mesh in small.scenes.mesh_names())
    assert [grid.scenes.camera.size for grid in (small, large)] == [(224, 224), (448, 448)]  # type: ignore[union-attr]
