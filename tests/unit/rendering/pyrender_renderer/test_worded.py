"""Sentences about perturbations, against closed forms and scipy's rotations."""

from math import radians

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from services.analysis.physical import changes_in_words
from services.rendering.factory import build
from services.rendering.physical_change import number
from services.rendering.pyrender_renderer.words import brightness, camera, color, lights, moved, rotation, translation
from services.scenes.description import Camera, Scene
from services.scenes.resolve import resolve
from services.scenes.view import camera_pose, camera_to_world
from tests.unit.jobs.small import LIBRARY

AXES = np.eye(3)
"""Of a camera that looks along the world's −z."""
SLANTED = camera_to_world(Camera(azimuth=0.7, elevation=0.4))[:3, :3].T


@pytest.mark.parametrize(
    ("change", "centimetres", "sentence"),
    [
        ((0.042, 0, 0), 100.0, "moved 4.2 cm right"),
        ((-0.042, 0.011, 0), 100.0, "moved 4.2 cm left and 1.1 cm up"),
        ((0, -0.03, -0.04), None, "moved 0.03 scene units down and 0.04 scene units away from the camera"),
        ((0.5, 0.001, 1), 12.0, "moved 6 cm right and 12 cm towards the camera"),
        ((0, 0, 0), 12.0, "did not move"),
    ],
)
def test_a_move_in_the_directions_of_the_image(
    change: tuple[float, float, float], centimetres: float | None, sentence: str
) -> None:
    assert moved(np.array(change), centimetres, AXES) == sentence
    turned = SLANTED.T @ np.array(change)  # the same as that camera sees it
    assert moved(turned, centimetres, SLANTED) == sentence


def test_a_move_has_the_coordinates_before_and_after() -> None:
    found = translation("drill", 0, np.array([0.1, 0, 0]), np.array([0.02, 0, -0.01]), 50.0, AXES)
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
@pytest.mark.parametrize("angle", [1e-5, 6.5, 120.0, 179.0])
def test_a_turn_from_any_pose(axis: tuple[float, float, float], words: str, angle: float) -> None:
    """The rotation vectors' difference has another length, unless the pose is none."""
    unit = np.array(axis) / np.linalg.norm(axis)
    before = Rotation.from_rotvec([0.4, -1.1, 0.3])
    after = Rotation.from_rotvec(radians(angle) * unit) * before
    found = rotation("drill", 0, before.as_rotvec(), after.as_rotvec() - before.as_rotvec(), SLANTED)
    assert found.sentence == words.format(number(angle))


def test_no_turn() -> None:
    assert rotation("drill", 0, np.array([0.4, 0, 0]), np.zeros(3), AXES).sentence == "did not turn"


def test_colours_in_percent_of_what_they_were() -> None:
    found = color("drill", 2, np.array([0.5, 1.0, 0.0]), np.array([-0.07, 0.031, 0.25]))
    assert found.sentence == "red −14 %, green +3.1 %, blue from 0 to 0.25"
    assert (found.values[0].name, found.values[0].after) == ("object 2 color red", pytest.approx(0.43))


def test_light() -> None:
    assert brightness(1.0, -0.23) == "23 % dimmer"
    assert brightness(0.4, 0.01) == "2.5 % brighter"
    assert brightness(0.0, 0.01) == "is no longer dark"


def test_lights_by_name_with_energies_in_their_own_units() -> None:
    names = ["ambient", "point 0 energy", "point 0 x", "point 0 y", "point 0 z"]
    names += ["directional 0 energy", *(f"directional 0 direction {axis}" for axis in "xyz")]
    initial = np.array([0.4, 1.0, 1, 2, 3, 1.0, 1, 0, 0])
    change = np.array([0.1, -0.23, 0, 0.03, 0, 0.0, 0, 1, 0])
    found = list(lights(names, initial, change, 100.0, AXES))
    assert [(one.subject, one.sentence) for one in found] == [
        ("ambient light", "25 % brighter"),
        ("lamp", "23 % dimmer and moved 3 cm up"),
        ("distant lamp", "as bright as before and its direction turned 45°"),
    ]
    values = {v.name: (v.unit, v.before, v.after) for one in found for v in one.values}
    assert values["point 0 energy"] == ("energy", 30, pytest.approx(23.1))
    assert values["point 0 y"] == ("cm", 200, pytest.approx(203))
    assert values["directional 0 energy"] == ("energy", 3, 3)
    assert values["directional 0 direction y"] == ("unit vector", 0, pytest.approx(0.5**0.5))


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
        assert word in camera(old, np.array(change), None).sentence
    assert camera(old, np.zeros(4), None).sentence == "did not move"
    rolled = camera(old, np.array([0, 0, 0, radians(-2)]), None)
    assert rolled.sentence == "rolled 2° to its right"


def test_a_perturbation_of_a_scene() -> None:
    described = {"camera": {"size": [32, 32]}, "objects": [{"mesh": "primitive/cube"}]}
    scene = resolve(Scene.model_validate(described), LIBRARY)
    renderer = build(scene, "pyrender", tolerance="exact")
    right = torch.from_numpy(scene.view[:3, 0].copy())
    found = changes_in_words(scene, renderer, {"translation": 0.05 * right[None], "color": torch.zeros(1, 3)})
    assert [(one.group, one.subject, one.sentence) for one in found] == [
        ("translation", "cube", "moved 0.05 scene units right"),
        ("color", "cube", "has its colour as before"),
    ]
