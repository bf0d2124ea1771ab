"""Requests as objects and as JSON: what is read is written again as it was, without the fields that were not set."""

import json
from pathlib import Path
from typing import Any

import pytest

import scene_attack as sa

ROOT = Path(__file__).parents[3]
SHOWN = json.loads((ROOT / "api" / "scene_attack_api" / "examples.json").read_text("utf-8"))
REQUESTS: dict[str, Any] = {
    **{path.stem: json.loads(path.read_text("utf-8")) for path in sorted((ROOT / "examples").glob("*.json"))},
    **{name: SHOWN[name]["request"] for name in ("submit_job", "preview_job", "submit_campaign")},
}


def spelt(request: Any) -> Any:
    """The request with each network of a grid as an object, which may be written as its name."""
    if isinstance(request, list):
        return [spelt(item) for item in request]
    if not isinstance(request, dict):
        return request
    named = [{"name": one} if isinstance(one, str) else one for one in request.get("targets", ())]
    return {key: named if key == "targets" else spelt(value) for key, value in request.items()}


@pytest.mark.parametrize("name", REQUESTS)
def test_an_example_is_the_same_after_reading_and_writing_it(name: str) -> None:
    request = REQUESTS[name]
    model: Any = sa.Campaign if "grids" in request else sa.Spec
    read = model.model_validate(request)
    written = read.model_dump(mode="json", exclude_unset=True)
    if "source" not in request.get("scene", {}):  # it is replaced by the scene that it makes
        assert written == spelt(request)
    assert model.model_validate(written) == read
    assert model.model_validate(read.model_dump(mode="json")) == read


def test_objects_are_the_request_that_says_the_same() -> None:
    spec = sa.Spec(
        scene=sa.Scene(objects=[sa.Object(mesh="furniture/grand-piano")], camera=sa.Camera(size=(64, 64))),
        attack=sa.FGSM(renderer="torch", groups=["normals"], steps=20),
        seed=7,
    )
    assert spec.model_dump(mode="json", exclude_unset=True) == SHOWN["submit_job"]["request"]


def test_an_attack_keeps_its_method_and_what_was_said_of_it() -> None:
    attack = sa.ZOO(renderer="pyrender", steps=3)
    scene = sa.Scene(objects=[sa.Object(mesh="primitive/cube")])
    written = sa.Spec(scene=scene, attack=attack).model_dump(mode="json", exclude_unset=True)
    assert written["attack"] == {"method": "zoo", "renderer": "pyrender", "steps": 3}
    assert sa.Spec.model_validate(written).attack == attack
