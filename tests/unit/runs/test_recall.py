from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from scene_attack.rendering.factory import build
from scene_attack.rendering.plan import Plan
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import KEPT_SCENES, MAX_KEPT_SCENES, MAX_MEASUREMENTS, plan, recall
from scene_attack.runs.result import Result
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.jobs.small import LIBRARY, spec

pytestmark = pytest.mark.slow

ATTACKS: list[dict[str, Any]] = [
    {"renderer": "image"},
    {"renderer": "torch"},
    {"renderer": "torch", "groups": ["illumination"]},
    {
        "renderer": "pyrender",
        "method": "zoo",
        "groups": ["illumination", "color"],
        "steps": 2,
        "delta": 1e-2,
        "coordinates": 8,
    },
    {"renderer": "pyrender", "method": "fgsm", "groups": ["rotation", "translation"], "steps": 2},
]
SCENES: dict[str, dict[str, Any]] = {
    "sphere": {},
    "textured": {"objects": [{"mesh": "furniture/air-conditioning-external-unit"}]},
    "shadows": {
        "objects": [{"mesh": "primitive/cube"}],
        "floor": {},
        "shadows": {},
    },
}
PIXELS = {"renderer": "image", "base_renderer": "pyrender", "method": "square"}
FILES = ("perturbation.safetensors", "original.png", "attacked.png", "perturbation.png")


@pytest.fixture(autouse=True)
def nothing_kept() -> Iterator[None]:
    KEPT_SCENES.clear()
    yield
    KEPT_SCENES.clear()


def _comparable(result: Result) -> dict[str, Any]:
    found = result.model_dump(mode="json", exclude={"cost": {"seconds"}})
    return found | {"trace": [row | {"seconds": 0} for row in found["trace"]]}


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: " ".join(map(str, attack.values())))
@pytest.mark.parametrize("scene", SCENES)
def test_a_job_that_recalls_is_the_job_that_measured(scene: str, attack: dict[str, Any], tmp_path: Path) -> None:
    asked = spec(attack, scene=SCENES[scene], tolerance=0.03)  # within which the texture is rasterised
    first = execute(asked, tmp_path / "first", LIBRARY)
    # Another drawing takes the place of the scene's in OpenGL; its textures have to be uploaded again.
    build(resolve(spec(scene={"objects": [{"mesh": "primitive/torus"}]}).scene, LIBRARY), "pyrender").render({})
    second = execute(asked, tmp_path / "second", LIBRARY)
    for name in FILES:
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "second" / name).read_bytes(), name
    assert _comparable(second) == _comparable(first)


def test_the_size_of_the_map_is_recalled(tmp_path: Path) -> None:
    light = {"lights": {"environment": {"map": "studio", "size": "auto"}}}
    asked = spec({"renderer": "torch", "steps": 1}, scene=light)
    first, second = (execute(asked, tmp_path / name, LIBRARY) for name in ("first", "second"))
    assert _comparable(second) == _comparable(first)


def test_what_was_measured_is_not_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = spec({"renderer": "pyrender", "method": "zoo", "groups": ["illumination"], "steps": 1})
    measured: list[object] = []
    once = ResolvedScene.once

    def counted(scene: ResolvedScene, what: Any, measure: Any) -> Any:
        return once(scene, what, lambda: measured.append(what) or measure())

    monkeypatch.setattr(ResolvedScene, "once", counted)
    execute(asked, tmp_path / "first", LIBRARY)
    assert measured
    before = list(measured)
    execute(asked, tmp_path / "second", LIBRARY)
    assert measured == before


def test_a_changed_copy_of_a_scene_begins_without_what_was_measured() -> None:
    scene = resolve(spec().scene, LIBRARY)
    assert [scene.once("number", iter([1, 2]).__next__) for _ in range(2)] == [1, 1]
    assert replace(scene, map_credit="somebody").once("number", lambda: 3) == 3


def test_other_groups_and_tolerances_are_measured_on_their_own(tmp_path: Path) -> None:
    attack = {"renderer": "torch", "groups": ["normals"], "steps": 1}
    execute(spec(attack), tmp_path / "normals", LIBRARY)
    alone = execute(spec(attack | {"groups": ["illumination"]}, tolerance=0.01), tmp_path / "after", LIBRARY)
    KEPT_SCENES.clear()
    fresh = execute(spec(attack | {"groups": ["illumination"]}, tolerance=0.01), tmp_path / "fresh", LIBRARY)
    assert alone.plan == fresh.plan


@pytest.mark.parametrize(
    ("groups", "tolerance"), [(["camera"], 0.03), (["illumination"], 0.01)], ids=["groups", "tolerance"]
)
def test_other_groups_and_tolerances_of_pyrender_have_their_own_plans(groups: list[str], tolerance: float) -> None:
    def planned(groups: list[str], tolerance: float) -> Plan:
        return plan(spec({"renderer": "pyrender", "method": "fgsm", "groups": groups}, tolerance=tolerance), LIBRARY)

    first = planned(["illumination"], 0.03)
    recalled = planned(groups, tolerance)
    KEPT_SCENES.clear()
    assert recalled == planned(groups, tolerance)
    assert recalled != first


def test_the_scenes_of_the_last_jobs_are_kept_and_no_more() -> None:
    for number in range(MAX_KEPT_SCENES + 3):
        scene = resolve(spec(scene={"camera": {"size": [64, 64], "azimuth": 0.1 * number}}).scene, LIBRARY)
        recall(scene).once("number", lambda: number)  # noqa: B023
    assert len(KEPT_SCENES) == MAX_KEPT_SCENES
    again = resolve(spec(scene={"camera": {"size": [64, 64], "azimuth": 0.1 * (MAX_KEPT_SCENES + 2)}}).scene, LIBRARY)
    assert recall(again).once("number", lambda: -1) == MAX_KEPT_SCENES + 2
    first = resolve(spec(scene={"camera": {"size": [64, 64], "azimuth": 0.0}}).scene, LIBRARY)
    assert recall(first).once("number", lambda: -1) == -1


def test_of_one_scene_no_more_is_kept_than_is_bounded() -> None:
    for number in range(3 * MAX_MEASUREMENTS):
        recall(resolve(spec().scene, LIBRARY)).once(("tolerance", number), lambda: number)  # noqa: B023
    [measured] = KEPT_SCENES.values()
    assert 0 < len(measured) <= MAX_MEASUREMENTS


def test_large_images_are_not_kept_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scene_attack.runs.prepare.MAX_KEPT_BYTES", 1000)
    for number in range(5):
        scene = resolve(spec(scene={"camera": {"size": [64, 64], "azimuth": 0.1 * number}}).scene, LIBRARY)
        recall(scene).once("exact image", lambda: torch.zeros(150))  # 600 bytes
    assert len(KEPT_SCENES) == 2  # the last one's own was not measured yet when it was recalled
    again = resolve(spec(scene={"camera": {"size": [64, 64], "azimuth": 0.4}}).scene, LIBRARY)
    recall(again).once("another", lambda: torch.zeros(200))
    assert recall(resolve(again.description, LIBRARY)).measured == {}
