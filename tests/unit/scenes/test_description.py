"""The field `shadows` of a scene, and the names of its objects."""

import json

import pytest
from pydantic import ValidationError

from scene_attack.scenes.description import Scene, SceneObject, Shadows, object_names
from scene_attack.scenes.resolve import canonical_json


def scene(**more: object) -> Scene:
    return Scene.model_validate({"objects": [SceneObject(mesh="primitive/sphere")], **more})


def test_a_scene_without_shadows_is_described_as_before_there_were_any() -> None:
    assert scene(shadows=None) == scene()
    assert "shadows" not in json.loads(canonical_json(scene()))
    assert "shadows" not in scene().model_dump()


def test_shadows_have_defaults_and_are_part_of_the_description() -> None:
    described = json.loads(canonical_json(scene(shadows={})))
    assert described["shadows"] == Shadows().model_dump()
    assert Scene.model_validate(described).shadows == Shadows()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("softness", x) for x in (-0.1, 11, float("nan"))),
        *(("angle", x) for x in (-0.1, 0.6, float("inf"))),
        *(("resolution", x) for x in (32, 100, 8192)),
        *(("samples", x) for x in (0, 65)),
        *(("texel_samples", x) for x in (0, 9)),
        ("hardness", 1),
    ],
)
def test_a_value_out_of_its_range_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValidationError, match=field):
        scene(shadows={field: value})


def test_objects_are_called_by_meshes_that_no_other_has() -> None:
    meshes = ("furniture/drill", "primitive/cube", "primitive/cube", "sha256:" + "0" * 64)
    scene = Scene.model_validate({"objects": [{"mesh": mesh} for mesh in meshes]})
    assert object_names(scene, {}) == ["drill", "object 1", "object 2", "object 3"]
    assert object_names(scene, {meshes[3]: "vase"}) == ["drill", "object 1", "object 2", "vase"]
    assert object_names(scene, {meshes[3]: "drill"}) == [f"object {k}" for k in range(4)]
