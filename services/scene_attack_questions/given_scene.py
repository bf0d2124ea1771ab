"""Compares a scene that a request gives beside its CLEVR record with the scene that the record describes."""

from math import isclose

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.description import Camera, Scene, SceneObject
from scene_attack_questions.clevr.description import record_after, scene_of
from scene_attack_questions.clevr.records import IMAGE_SIZE, SceneRecord
from scene_attack_questions.executor import Facts

PROPORTION = 0.01
"""Largest relative difference of an image's proportions from those of CLEVR's."""
ROUNDING = 1e-6
"""Largest difference between a scene and the one that follows from its record, for a record that was described on
another machine, whose trigonometric functions round differently."""


def check_scene(scene: Scene, record: SceneRecord) -> None:
    """Checks a scene that is given beside its record.

    Raises InvalidRequest("scene") unless objects and camera are those of the record, and as `scene_of` does.
    Raises InvalidRequest("scene.camera.size") for an image of other proportions, whose frame would be another.
    """
    due = scene_of(record)
    same = len(scene.objects) == len(due.objects) and all(
        _is_same(thing, other) for thing, other in zip(scene.objects, due.objects, strict=True)
    )
    if not same or not _is_seen_from(scene.camera, due.camera):
        raise InvalidRequest("scene", "its objects and camera are not those of `record`; leave it out")
    rows, columns = scene.camera.size
    if not isclose(rows / columns, IMAGE_SIZE[0] / IMAGE_SIZE[1], rel_tol=PROPORTION):
        raise InvalidRequest(
            "scene.camera.size", f"{rows}×{columns} has not the proportions of CLEVR's images, 3 to 4, as 240×320 has"
        )
    if Facts.of(record_after(record, scene)) != Facts.of(record):
        raise InvalidRequest("record", "its attributes and relations are not those of its objects")


def _is_same(thing: SceneObject, other: SceneObject) -> bool:
    fields = ("mesh", "material", "metallic", "roughness")
    vectors = ("color", "translation", "rotation")
    return (
        all(getattr(thing, name) == getattr(other, name) for name in fields)
        and isclose(thing.scale, other.scale, abs_tol=ROUNDING)
        and all(
            isclose(a, b, abs_tol=ROUNDING)
            for name in vectors
            for a, b in zip(getattr(thing, name), getattr(other, name), strict=True)
        )
    )


def _is_seen_from(camera: Camera, other: Camera) -> bool:
    places = ("azimuth", "elevation", "distance", "field_of_view")
    return all(isclose(getattr(camera, name), getattr(other, name), abs_tol=ROUNDING) for name in places)
