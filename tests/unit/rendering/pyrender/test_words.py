"""Sizes and sentences of perturbations, against closed forms and scipy's rotations."""

from math import degrees, radians

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from scene_attack.rendering.factory import build
from scene_attack.rendering.physical_change import Worded, number, worded
from scene_attack.rendering.pose import Length, camera, rotation, translation
from scene_attack.rendering.pyrender.words import color, lights
from scene_attack.scenes.description import Camera, Scene
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack.scenes.view import camera_pose, camera_to_world
from tests.unit.jobs.small import LIBRARY

AXES = np.eye(3)
"""Of a camera that looks along the world's −z."""
SLANTED = camera_to_world(Camera(azimuth=0.7, elevation=0.4))[:3, :3].T


def scene_of(**placed: object) -> ResolvedScene:
    return resolve(Scene.model_validate({"objects": [placed], "camera": {"size": [32, 32]}}), LIBRARY)


def sizes(*things: Worded) -> dict[tuple[str, str], tuple[object, str]]:
    return {(size.subject, size.measure): (size.value, size.unit) for thing in things for size in thing.sizes}


@pytest.mark.parametrize(
    ("change", "length", "sentence", "distance"),
    [
        ((0.042, 0, 0), Length("cm", 100.0), "moved 4.2 cm right", 4.2),
        ((-0.042, 0.011, 0), Length("cm", 100.0), "moved 4.2 cm left and 1.1 cm up", 4.3417),
        ((0, -0.03, -0.04), Length(), "moved 0.03 scene units down and 0.04 scene units away from the camera", 0.05),
        ((0.5, 0.001, 1), Length("cm", 12.0), "moved 6 cm right and 12 cm towards the camera", 13.41641),
        ((0, 0, 0), Length("cm", 12.0), "did not move", 0),
    ],
)
def test_a_move_in_the_directions_of_the_image(
    change: tuple[float, float, float], length: Length, sentence: str, distance: float
) -> None:
    for axes in (AXES, SLANTED):
        thing = translation("drill", 0, np.zeros(3), axes.T @ np.array(change), length, axes)  # as that camera sees it
        assert thing.change.sentence == sentence
        assert sizes(thing) == {("object 0", "distance"): (pytest.approx(distance, rel=1e-4), length.unit)}


def test_a_move_has_the_coordinates_before_and_after() -> None:
    change, length = np.array([0.02, 0, -0.01]), Length("cm", 50.0)
    found = translation("drill", 0, np.array([0.1, 0, 0]), change, length, AXES).change
    assert [(v.name, v.unit, v.before, v.after) for v in found.values] == [
        ("object 0 translation x", "cm", pytest.approx(5), pytest.approx(6)),
        ("object 0 translation y", "cm", 0, 0),
        ("object 0 translation z", "cm", 0, pytest.approx(-0.5)),
    ]


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        ((0, 1, 0), "turned {}° anticlockwise seen from above"),
        ((0, -1, 0), "turned {}° clockwise seen from above"),
        (SLANTED[2], "turned {}° anticlockwise in the image"),
        (-SLANTED[2], "turned {}° clockwise in the image"),
        (SLANTED[0], "tipped {}° towards the camera"),
        (-SLANTED[0], "tipped {}° away from the camera"),
        ((1, 1, 0), "turned {}° about a slanted axis"),
    ],
)
@pytest.mark.parametrize("angle", [1e-7, 1e-5, 6.5, 120.0, 179.0])
def test_a_turn_from_any_pose(axis: tuple[float, float, float], words: str, angle: float) -> None:
    """The rotation vectors' difference has another length, unless the pose is none."""
    unit = np.array(axis) / np.linalg.norm(axis)
    before = Rotation.from_rotvec([0.4, -1.1, 0.3])
    after = Rotation.from_rotvec(radians(angle) * unit) * before
    change = after.as_rotvec() - before.as_rotvec()
    thing = rotation("drill", 0, before.as_rotvec(), change, SLANTED)
    assert thing.change.sentence == words.format(number(angle))
    assert sizes(thing) == {("object 0", "angle"): (pytest.approx(angle, rel=1e-6), "degrees")}


def test_no_turn() -> None:
    assert rotation("drill", 0, np.array([0.4, 0, 0]), np.zeros(3), AXES).change.sentence == "did not turn"


def test_colours_in_percent_of_what_they_were() -> None:
    thing = color("drill", 2, np.array([0.5, 1.0, 0.0]), np.array([-0.07, 0.031, 0.025]))
    assert thing.change.sentence == "red −14 %, green +3.1 %, blue from 0 to 0.025"
    assert (thing.change.values[0].name, thing.change.values[0].after) == ("object 2 color red", pytest.approx(0.43))
    assert sizes(thing) == {("object 2", "largest channel"): (pytest.approx(-7), "% of full range")}


def test_lights_by_name_with_energies_in_their_own_units() -> None:
    names = ["ambient", "point 0 energy", "point 0 x", "point 0 y", "point 0 z"]
    names += ["directional 0 energy", *(f"directional 0 direction {axis}" for axis in "xyz")]
    names += ["spot 0 energy", *(f"spot 0 {axis}" for axis in "xyz"), *(f"spot 0 direction {axis}" for axis in "xyz")]
    initial = np.array([0.4, 1.0, 1, 2, 3, 1.0, 1, 0, 0, 0.0, 0, 0, 0, 1, 0, 0])
    change = np.array([0.1, -0.23, 0, 0.03, 0, 0.0, 0, 1, 0, 0.5, 0.3, 0, 0.4, 0, 0, 0])
    things = list(lights(names, initial, change, Length("cm", 100.0), AXES))
    assert [(thing.change.subject, thing.change.sentence) for thing in things] == [
        ("ambient light", "25 % brighter"),
        ("lamp", "23 % dimmer and moved 3 cm up"),
        ("distant lamp", "as bright as before and its direction turned 45°"),
        (
            "spotlight",
            "is no longer dark, moved 30 cm right and 40 cm towards the camera and its direction turned 0°",
        ),
    ]
    values = {v.name: (v.unit, v.before, v.after) for thing in things for v in thing.change.values}
    assert values["point 0 energy"] == ("energy", 30, pytest.approx(23.1))
    assert values["point 0 y"] == ("cm", 200, pytest.approx(203))
    assert values["directional 0 energy"] == ("energy", 3, 3)
    assert values["directional 0 direction y"] == ("unit vector", 0, pytest.approx(0.5**0.5))
    assert sizes(*things) == {
        ("ambient", "change"): (pytest.approx(25), "%"),
        ("point 0 energy", "change"): (pytest.approx(-23), "%"),
        ("point 0", "distance"): (pytest.approx(3), "cm"),
        ("directional 0 energy", "change"): (0, "%"),
        ("directional 0 direction", "angle"): (pytest.approx(45), "degrees"),
        ("spot 0", "distance"): (pytest.approx(50), "cm"),
        ("spot 0 direction", "angle"): (0, "degrees"),
    }


def test_the_camera_moves_as_its_pose_does() -> None:
    """Right, up and nearer are where the camera's position goes in its own frame."""
    old = np.array([0.7, 0.3, 1.8, 0.0])
    for change, words in (
        ((0.01, 0, 0, 0), ("left", "right")),
        ((0, 0.01, 0, 0), ("down", "up")),
        ((0, 0, 0.01, 0), ("nearer", "farther")),
    ):
        before, after = camera_pose(*old), camera_pose(*(old + change))
        place = before[:3, :3].T @ (after - before)[:3, 3]
        word = words[int(place[int(np.abs(place).argmax())] > 0)]
        assert word in camera(old, np.array(change), Length()).change.sentence
    assert camera(old, np.zeros(4), Length()).change.sentence == "did not move"
    rolled = camera(old, np.array([0, 0, 0, radians(-2)]), Length())
    assert rolled.change.sentence == "rolled 2° to its right"


def test_the_camera_turns_by_signed_angles_and_moves_by_a_distance() -> None:
    change = np.array([0.1, -0.2, -0.5, 0.3])
    assert sizes(camera(np.array([0.7, 0.3, 1.8, 0.0]), change, Length("cm", 100.0))) == {
        ("azimuth", "angle"): (pytest.approx(degrees(0.1)), "degrees"),
        ("elevation", "angle"): (pytest.approx(degrees(-0.2)), "degrees"),
        ("roll", "angle"): (pytest.approx(degrees(0.3)), "degrees"),
        ("camera", "distance"): (pytest.approx(50), "cm"),
    }


def test_a_perturbation_of_a_scene() -> None:
    scene = scene_of(mesh="primitive/cube")
    renderer = build(scene, "pyrender", tolerance="exact")
    right = torch.from_numpy(scene.view[:3, 0].copy())
    found = worded(scene, renderer, {"translation": 0.05 * right[None], "color": torch.zeros(1, 3)})
    assert [(thing.change.group, thing.change.subject, thing.change.sentence) for thing in found] == [
        ("translation", "cube", "moved 0.05 scene units right"),
        ("color", "cube", "has its colour as before"),
    ]


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_smaller_object_moves_by_more_of_its_own_centimetres(scale: float) -> None:
    """The catalogue's chair is 82 cm high; however it is scaled, a move by its own height is one by 82 cm."""
    scene = scene_of(mesh="furniture/chair", scale=scale)
    vertices = np.concatenate([part.vertices for part in scene.meshes[0].parts])
    corners = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1) @ scene.models[0].T
    height = float(np.ptp(corners[:, 1]))
    moved = {"translation": torch.tensor([[0.0, height, 0.0]]), "camera": torch.tensor([0.0, 0.0, height, 0.0])}
    found = sizes(*worded(scene, build(scene, "pyrender", tolerance="exact"), moved))
    assert found["object 0", "distance"] == (pytest.approx(82.0, rel=1e-3), "cm")
    assert found["camera", "distance"] == (pytest.approx(82.0, rel=1e-3), "cm")
