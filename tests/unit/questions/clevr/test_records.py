"""CLEVR's scene files: read, written, refused; and the relations of their objects."""

import json
from pathlib import Path

import numpy as np
import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.view import camera_to_world, projection
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import Info, SceneFile, relationships

OFFICIAL = {
    "info": {
        "split": "val",
        "license": "Creative Commons Attribution (CC BY 4.0)",
        "version": "1.0",
        "date": "2/14/2017",
    },
    "scenes": [
        {
            "image_index": 3,
            "image_filename": "CLEVR_val_000003.png",
            "split": "val",
            "objects": [
                {
                    "color": "cyan",
                    "size": "large",
                    "rotation": 214.25,
                    "shape": "cylinder",
                    "3d_coords": [1.25, -0.5, 0.699999988079071],
                    "material": "metal",
                    "pixel_coords": [188, 120, 9.75],
                },
                {
                    "color": "gray",
                    "size": "small",
                    "rotation": 10.5,
                    "shape": "cube",
                    "3d_coords": [-1.5, 0.25, 0.3499999940395355],
                    "material": "rubber",
                    "pixel_coords": [121, 79, 12.125],
                },
            ],
            "relationships": {"right": [[], [0]], "behind": [[1], []], "front": [[], [0]], "left": [[1], []]},
            "directions": {
                "right": [0.65625, 0.75390625, 0.0],
                "behind": [-0.75390625, 0.65625, 0.0],
                "above": [0.0, 0.0, 1.0],
                "below": [0.0, 0.0, -1.0],
                "left": [-0.65625, -0.75390625, 0.0],
                "front": [0.75390625, -0.65625, 0.0],
            },
        }
    ],
}
"""A file as those of CLEVR v1.0 are: their fields, in their order, with other values."""


def stored(tmp_path: Path, content: object) -> Path:
    path = tmp_path / "scenes.json"
    path.write_text(json.dumps(content))
    return path


def damaged(change) -> dict:
    content = json.loads(json.dumps(OFFICIAL))
    change(content["scenes"][0])
    return content


def test_an_official_file_is_written_as_it_was_read(tmp_path: Path) -> None:
    file = SceneFile.read(stored(tmp_path, OFFICIAL))
    assert file.scenes[0].objects[1].coords_3d == (-1.5, 0.25, 0.3499999940395355)
    assert file.scenes[0].rig is None
    file.write(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == OFFICIAL


def test_fields_of_others_are_kept(tmp_path: Path) -> None:
    content = damaged(lambda scene: scene.update(mask=[1, 2]) or scene["objects"][0].update(bbox={"x": None}))
    file = SceneFile.read(stored(tmp_path, content))
    file.write(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == content


def test_generated_scenes_are_read_as_they_were_written(tmp_path: Path) -> None:
    scenes = tuple(generate(1, k) for k in range(10))
    file = SceneFile(info=Info(split="new", version="1.0", date="", license=""), scenes=scenes)
    file.write(tmp_path / "scenes.json")
    again = SceneFile.read(tmp_path / "scenes.json")
    assert again == file
    assert again.scenes[4].rig == scenes[4].rig
    keys = set(json.loads((tmp_path / "scenes.json").read_text())["scenes"][0])
    assert keys == {*OFFICIAL["scenes"][0], "camera", "lights"}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda scene: scene["objects"][1].update(color="pink"), "scenes.0.objects.1.color"),
        (lambda scene: scene["objects"][0].pop("3d_coords"), "scenes.0.objects.0.3d_coords"),
        (lambda scene: scene["objects"][0].update(rotation="much"), "scenes.0.objects.0.rotation"),
        (lambda scene: scene["relationships"].update(left=[[0]]), "scenes.0"),
        (lambda scene: scene["relationships"].update(left=[[7], []]), "scenes.0"),
        (lambda scene: scene["relationships"].pop("front"), "scenes.0"),
    ],
)
def test_a_damaged_file_is_refused_with_the_field(change, field: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest) as caught:
        SceneFile.read(stored(tmp_path, damaged(change)))
    assert caught.value.field == field


def test_a_file_that_is_no_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scenes.json").write_text("{")
    with pytest.raises(InvalidRequest, match=r"scenes\.json"):
        SceneFile.read(tmp_path / "scenes.json")


@pytest.fixture(params=range(5))
def scene(request: pytest.FixtureRequest):
    return generate(11, request.param)


def test_pixel_coordinates_are_the_projected_centres(scene) -> None:
    camera = describe(scene).camera
    world = np.array([[*one.translation, 1.0] for one in describe(scene).objects])
    seen = world @ np.linalg.inv(camera_to_world(camera)).T
    clip = seen @ projection(camera, 100.0).T
    for one, depth, point in zip(scene.objects, -seen[:, 2], clip, strict=True):
        x, y = point[:2] / point[3]
        assert one.pixel_coords[2] == pytest.approx(depth, rel=1e-12)
        assert abs(one.pixel_coords[0] - (x + 1) / 2 * 320) <= 0.5 + 1e-9
        assert abs(one.pixel_coords[1] - (1 - y) / 2 * 240) <= 0.5 + 1e-9


def test_directions_are_unit_vectors_in_the_plane_and_opposite(scene) -> None:
    for first, second in (("left", "right"), ("front", "behind"), ("above", "below")):
        along = np.array(scene.directions[first])
        assert np.linalg.norm(along) == pytest.approx(1)
        assert np.array_equal(along, -np.array(scene.directions[second]))


def test_objects_within_the_offset_are_unrelated() -> None:
    along = {"left": (1, 0, 0), "right": (-1, 0, 0), "front": (0, 1, 0), "behind": (0, -1, 0)}
    found = relationships([(0, 0, 0), (0.19, 0.21, 0)], along)
    assert found == {"left": [[], []], "right": [[], []], "front": [[1], []], "behind": [[], [0]]}
