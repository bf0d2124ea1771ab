"""Records read back from descriptions, against attributes and relations that are found here another way."""

from math import degrees

import numpy as np
import pytest

from services.scenes.clevr.description import describe, nearest_color, other_readings, record_after, rig_after, rig_of
from services.scenes.clevr.generator import generate
from services.scenes.clevr.records import RGB, SceneRecord
from services.scenes.description import Scene
from services.scenes.view import camera_to_world

RECORDS = [generate(21, k, objects=(5, 8)) for k in range(4)]


def moved(scene: Scene, k: int, **changes: object) -> Scene:
    """The scene with other values of object k."""
    objects = list(scene.objects)
    objects[k] = objects[k].model_copy(update=changes)
    return scene.model_copy(update={"objects": tuple(objects)})


def seen(scene: Scene) -> dict[str, list[list[int]]]:
    """The relations of a description's objects along its camera's axes."""
    pose = camera_to_world(scene.camera)
    right, towards = pose[:3, 0], pose[:3, 2]
    away = -np.array([towards[0], 0.0, towards[2]]) / np.hypot(towards[0], towards[2])
    centres = np.array([one.translation for one in scene.objects])
    offsets = {
        name: (centres[None] - centres[:, None]) @ along
        for name, along in (("right", right), ("left", -right), ("behind", away), ("front", -away))
    }
    return {name: [list(np.flatnonzero(row > 0.2)) for row in rows] for name, rows in offsets.items()}


def stated(record: SceneRecord) -> dict[str, list[list[int]]]:
    return {name: [list(row) for row in rows] for name, rows in record.relationships.items()}


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: str(record.image_index))
def test_an_unchanged_scene_has_its_record(record: SceneRecord) -> None:
    found = record_after(record, describe(record))
    assert stated(found) == stated(record)
    for old, new in zip(record.objects, found.objects, strict=True):
        assert (new.shape, new.size, new.material, new.color) == (old.shape, old.size, old.material, old.color)
        assert new.coords_3d == old.coords_3d
        assert new.pixel_coords[:2] == old.pixel_coords[:2]
        assert new.rotation == pytest.approx(old.rotation)


def test_a_colour_is_the_nearest_of_the_eight() -> None:
    random = np.random.default_rng(0)
    names, colors = list(RGB), np.array(list(RGB.values())) / 255
    for color in random.uniform(0, 1, (200, 3)):
        distances = np.linalg.norm(colors - color, axis=1)
        assert nearest_color(tuple(color)) == names[int(distances.argmin())]
        about_as_near = {name for name, far in zip(names, distances, strict=True) if far < 2 * distances.min()}
        assert {nearest_color(tuple(color)), *other_readings(tuple(color))} == about_as_near


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: str(record.image_index))
def test_relations_follow_places_and_camera(record: SceneRecord) -> None:
    random = np.random.default_rng(record.image_index)
    scene = describe(record)
    for k in range(len(record.objects)):
        x, y, z = scene.objects[k].translation
        scene = moved(scene, k, translation=(x + random.uniform(-2, 2), y, z + random.uniform(-2, 2)))
    assert stated(record_after(record, scene)) == seen(scene) != stated(record)
    turned = scene.model_copy(
        update={"camera": scene.camera.model_copy(update={"azimuth": scene.camera.azimuth + 0.7})}
    )
    assert stated(record_after(record, turned)) == seen(turned) != seen(scene)


def test_the_rig_is_where_the_description_s_camera_is() -> None:
    record = RECORDS[0]
    scene = describe(record)
    camera = scene.camera.model_copy(update={"azimuth": 2.0, "elevation": 0.3, "distance": 9.0})
    place = camera_to_world(camera)[:3, 3]
    assert rig_after(record, camera).camera == pytest.approx((place[0], -place[2], place[1]))
    assert rig_after(record, scene.camera).camera == pytest.approx(rig_of(record).camera)


def test_a_turn_is_about_the_vertical_axis() -> None:
    record = RECORDS[1]
    scene = moved(describe(record), 0, rotation=(0.0, 0.5, 0.0))
    assert record_after(record, scene).objects[0].rotation == pytest.approx(degrees(0.5))
