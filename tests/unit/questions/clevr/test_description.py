"""A record as a scene's description, one that a request gives, and one read back after an attack."""

from itertools import product
from math import cos, degrees, pi, radians, sin
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.description import Scene
from scene_attack.scenes.primitives import primitive
from scene_attack.scenes.view import camera_to_world, model_matrix
from scene_attack_questions.clevr import description
from scene_attack_questions.clevr.description import (
    describe,
    nearest_color,
    other_readings,
    record_after,
    rig_after,
    rig_of,
    scene_of,
)
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import RGB, CameraRecord, Rig, SceneRecord, relationships
from scene_attack_questions.source import Generate

SCENES = [generate(5, k) for k in range(12)]


def vertices(placed) -> np.ndarray:
    (part,) = primitive(placed.mesh.removeprefix("primitive/")).parts
    matrix = model_matrix(placed)
    return part.vertices @ matrix[:3, :3].T + matrix[:3, 3]


def test_objects_stand_on_the_floor_with_the_size_of_their_word() -> None:
    radius = {"small": 0.35, "large": 0.7}
    for scene in SCENES:
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True):
            points = vertices(placed)
            x, y, _ = one.coords_3d
            assert points[:, 1].min() == pytest.approx(0, abs=1e-5)
            height = 2 * radius[one.size] / (2**0.5 if one.shape == "cube" else 1)
            assert points[:, 1].max() == pytest.approx(height, rel=1e-4)
            # All fit into a circle in the plane, which they touch.
            assert np.hypot(points[:, 0] - x, points[:, 2] + y).max() == pytest.approx(radius[one.size], rel=2e-3)


def test_a_turn_of_a_cube_is_about_the_vertical_axis() -> None:
    one, placed = next(
        (one, placed)
        for scene in SCENES
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True)
        if one.shape == "cube"
    )
    half, angle = one.coords_3d[2], radians(one.rotation)
    x, y, _ = one.coords_3d
    found = vertices(placed)[:, [0, 2]] * (1, -1)
    for u, v in product((-half, half), repeat=2):
        corner = np.array([x + u * cos(angle) - v * sin(angle), y + u * sin(angle) + v * cos(angle)])
        assert np.linalg.norm(found - corner, axis=1).min() < 1e-4


def test_camera_and_lights_are_where_the_record_says() -> None:
    for scene in SCENES:
        described, rig = describe(scene), scene.rig
        x, y, z = rig.camera
        assert camera_to_world(described.camera)[:3, 3] == pytest.approx([x, z, -y])
        assert [light.position for light in described.lights.points] == [
            (a, c, -b) for a, b, c in (rig.key, rig.fill, rig.back)
        ]
        assert described.camera.size == (240, 320)
        # A lens of 35 mm before a sensor of 32 mm by 24 mm.
        assert np.tan(described.camera.field_of_view / 2) == pytest.approx(12 / 35)


def test_colours_are_clevr_s_as_linear_reflectances() -> None:
    for scene in SCENES:
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True):
            assert placed.color == pytest.approx([c / 255 for c in RGB[one.color]])


def test_metal_and_rubber_differ_in_each_renderer_s_terms() -> None:
    expected = {"rubber": (0.0, 0.7), "metal": (1.0, 0.4)}
    presets = {one.material: set() for scene in SCENES for one in scene.objects}
    for scene in SCENES:
        for one, placed in zip(scene.objects, describe(scene).objects, strict=True):
            presets[one.material].add(placed.material)
            assert (placed.metallic, placed.roughness) == expected[one.material]
    assert len(presets["rubber"]) == len(presets["metal"]) == 1
    assert presets["rubber"] != presets["metal"]


def test_a_record_without_a_rig_gets_the_base_scene_s_from_its_own_side() -> None:
    for scene in SCENES:
        bare = scene.model_copy(update={"camera": None, "lights": None})
        rig, base = rig_of(bare), Rig()
        camera = np.array(rig.camera)
        assert camera[:2] / np.hypot(*camera[:2]) == pytest.approx(np.array(scene.directions["front"][:2]))
        assert rig.elevation == pytest.approx(base.elevation)
        assert rig.distance == pytest.approx(base.distance)
        # The lights turn with the camera.
        between = np.arctan2(rig.key[1], rig.key[0]) - np.arctan2(rig.camera[1], rig.camera[0])
        before = np.arctan2(base.key[1], base.key[0]) - np.arctan2(base.camera[1], base.camera[0])
        assert (between - before + pi) % (2 * pi) == pytest.approx(pi)


def test_the_floor_fills_the_frame_of_every_camera() -> None:
    x, y, z = Rig().camera
    for corner in product((-0.5, 0.5), repeat=3):
        position = (x + corner[0], y + corner[1], z + corner[2])
        scene = SCENES[0].model_copy(update={"camera": CameraRecord(position=position)})
        pose = camera_to_world(describe(scene).camera)
        for across in (-16 / 35, 16 / 35):
            ray = pose[:3, :3] @ np.array([across, 12 / 35, -1])
            assert ray[1] < 0
            floor = pose[:3, 3] - ray * pose[1, 3] / ray[1]
            assert abs(floor[[0, 2]]).max() < description.FLOOR_SIZE / 2


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
    monkeypatch.setattr("scene_attack_questions.clevr.generator.REACH", 0.5)  # a plane on which no three fit
    monkeypatch.setattr("scene_attack_questions.clevr.generator.RESTARTS", 3)
    with pytest.raises(InvalidRequest, match="do not fit") as refused:
        Generate(objects=9).record()
    assert refused.value.field == "generate.objects"


def test_a_record_becomes_its_description() -> None:
    assert scene_of(RECORD) == describe(RECORD)


def test_a_misplaced_object_is_refused_by_its_field() -> None:
    z = RECORD.objects[2].coords_3d[2]
    with pytest.raises(InvalidRequest, match="inside the frame") as refused:
        scene_of(changed(2, coords_3d=(40.0, 0.0, z)))
    assert refused.value.field == "record.objects.2"


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


ATTACKED = [generate(21, k, objects=(5, 8)) for k in range(4)]


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


@pytest.mark.parametrize("record", ATTACKED, ids=lambda record: str(record.image_index))
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


@pytest.mark.parametrize("record", ATTACKED, ids=lambda record: str(record.image_index))
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
    record = ATTACKED[0]
    scene = describe(record)
    camera = scene.camera.model_copy(update={"azimuth": 2.0, "elevation": 0.3, "distance": 9.0})
    place = camera_to_world(camera)[:3, 3]
    assert rig_after(record, camera).camera == pytest.approx((place[0], -place[2], place[1]))
    assert rig_after(record, scene.camera).camera == pytest.approx(rig_of(record).camera)


def test_a_turn_is_about_the_vertical_axis() -> None:
    record = ATTACKED[1]
    scene = moved(describe(record), 0, rotation=(0.0, 0.5, 0.0))
    assert record_after(record, scene).objects[0].rotation == pytest.approx(degrees(0.5))
