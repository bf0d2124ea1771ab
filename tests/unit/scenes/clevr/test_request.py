"""Scenes that a request gives as records or lets generate, and what is refused of them."""

from typing import Any

import pytest
from pydantic import ValidationError

from services.errors import InvalidRequest
from services.scenes.clevr.description import Generate, describe, scene_of
from services.scenes.clevr.generator import generate
from services.scenes.clevr.records import SceneRecord, relationships

RECORD = generate(3, 1, objects=(4, 4))


def changed(k: int, **values: Any) -> SceneRecord:
    """RECORD with other values of object k, read anew."""
    data = RECORD.model_dump(mode="json")
    data["objects"][k] |= values
    return SceneRecord.model_validate(data)


def test_a_generated_scene_is_that_of_the_generator() -> None:
    asked = Generate(seed=3, index=1, objects=4)
    assert asked.record() == RECORD
    assert len(asked.model_copy(update={"objects": 9}).record().objects) == 9
    for objects in (0, 11):
        with pytest.raises(ValidationError):
            Generate(objects=objects)


def test_more_than_fit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.scenes.clevr.generator.REACH", 0.5)  # a plane on which no three fit
    monkeypatch.setattr("services.scenes.clevr.generator.RESTARTS", 3)
    with pytest.raises(InvalidRequest, match="do not fit") as refused:
        Generate(objects=9).record()
    assert refused.value.field == "generate.objects"


def test_a_record_becomes_its_description() -> None:
    assert scene_of(RECORD) == describe(RECORD)


def test_objects_that_float_or_overlap_or_leave_the_frame_are_refused() -> None:
    x, y, z = RECORD.objects[0].coords_3d
    there = RECORD.objects[1].coords_3d
    cases = [
        (changed(0, coords_3d=(x, y, z + 0.5)), "record.objects.0", "floats above the plane by 0.5"),
        (changed(0, coords_3d=(there[0] + 0.1, there[1], z)), "record.objects.1", "overlaps object 0"),
        (changed(2, coords_3d=(40.0, 0.0, RECORD.objects[2].coords_3d[2])), "record.objects.2", "inside the frame"),
    ]
    for record, field, words in cases:
        with pytest.raises(InvalidRequest, match=words) as refused:
            scene_of(record)
        assert refused.value.field == field


def test_relations_must_be_those_of_the_places() -> None:
    data = RECORD.model_dump(mode="json")
    left = data["relationships"]["left"]
    k = next(k for k, row in enumerate(left) if row)
    left[k] = left[k][1:]
    with pytest.raises(InvalidRequest, match="by their places") as refused:
        scene_of(SceneRecord.model_validate(data))
    assert refused.value.field == f"record.relationships.left.{k}"


def test_a_scene_has_objects_and_directions() -> None:
    empty = RECORD.model_copy(update={"objects": ()})
    with pytest.raises(InvalidRequest, match="1 to 10"):
        scene_of(empty)
    blind = RECORD.model_copy(update={"directions": {"left": (1.0, 0.0, 0.0)}})
    with pytest.raises(InvalidRequest, match="no direction of right"):
        scene_of(blind)


def towards(*, camera: bool = True, **changes: tuple[float, float, float]) -> SceneRecord:
    """RECORD with other directions, and with the relations that its places have along them."""
    data = RECORD.model_dump(mode="json")
    data["directions"] |= changes
    data["relationships"] = relationships([one.coords_3d for one in RECORD.objects], data["directions"])
    if not camera:
        del data["camera"], data["lights"]
    return SceneRecord.model_validate(data)


@pytest.mark.parametrize("camera", [True, False])
def test_directions_must_be_those_of_the_camera(camera: bool) -> None:
    """Else what is right by the record is not what the image shows."""
    left, right = RECORD.directions["left"], RECORD.directions["right"]
    x, y, z = left
    cases = [
        ({"left": right, "right": left}, "left"),
        ({"left": (0.0, 0.0, 0.0)}, "left"),
        ({"right": (5 * right[0], 5 * right[1], 0.0)}, "right"),
    ]
    for changes, name in cases:
        with pytest.raises(InvalidRequest, match="it is") as refused:
            scene_of(towards(camera=camera, **changes))
        assert refused.value.field == f"record.directions.{name}"
    assert scene_of(towards(camera=camera, left=(x + 1e-4, y - 1e-4, z)))  # as exact as official files are


def test_a_camera_and_lights_are_given_together() -> None:
    """One alone would not be used, and the image would be another than the sender meant."""
    for absent in ("camera", "lights"):
        with pytest.raises(InvalidRequest, match="or leave out both") as refused:
            scene_of(RECORD.model_copy(update={absent: None}))
        assert refused.value.field == f"record.{absent}"
