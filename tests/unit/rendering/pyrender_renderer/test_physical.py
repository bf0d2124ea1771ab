"""Degrees, centimetres and percent against closed forms."""

from math import degrees, radians

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from services.rendering.pyrender_renderer.words import (
    camera_changes,
    changes,
    color_changes,
    light_changes,
    rotation_changes,
    translation_changes,
)
from services.scenes.description import Scene
from services.scenes.resolve import resolve
from tests.unit.jobs.small import LIBRARY


def test_energies_in_percent_positions_in_centimetres_directions_in_degrees() -> None:
    names = ["ambient", "point 0 energy", "point 0 x", "point 0 y", "point 0 z"]
    names += ["spot 0 energy", "spot 0 x", "spot 0 y", "spot 0 z"]
    names += ["spot 0 direction x", "spot 0 direction y", "spot 0 direction z"]
    initial = np.array([0.4, 1.0, 1, 2, 3, 0.0, 0, 0, 0, 1, 0, 0])
    change = np.array([-0.1, 0.02, 0.3, 0.0, 0.4, 1.0, 0, 0, 0.5, 0, 1, 0])
    found = {(c.subject, c.measure): (c.value, c.unit) for c in light_changes(names, initial, change, 80.0)}
    assert found == {
        ("ambient", "change"): (pytest.approx(-25), "%"),
        ("point 0 energy", "change"): (pytest.approx(2), "%"),
        ("point 0", "distance"): (pytest.approx(40), "cm"),  # 0.5 units
        ("spot 0", "distance"): (pytest.approx(40), "cm"),
        ("spot 0 direction", "angle"): (pytest.approx(45), "degrees"),
    }
    assert [c.unit for c in light_changes(names, initial, change, None) if c.measure == "distance"] == 2 * [
        "scene units"
    ]


def test_an_object_turns_by_the_angle_between_its_two_poses() -> None:
    """Against scipy; the length of the difference of two rotation vectors is another number."""
    random = np.random.default_rng(0)
    initial, change = random.normal(size=(20, 3)), random.normal(size=(20, 3)) * 0.3
    change[0] *= 1e-9
    found = [c.value for c in rotation_changes(initial, change)]
    turned = Rotation.from_rotvec(initial + change) * Rotation.from_rotvec(initial).inv()
    assert found == pytest.approx(np.degrees(turned.magnitude()), rel=1e-6)
    assert max(abs(a - degrees(np.linalg.norm(b))) for a, b in zip(found, change, strict=True)) > 0.1


def test_from_no_rotation_the_angle_is_the_vectors_length() -> None:
    [found] = rotation_changes(np.zeros((1, 3)), np.array([[0, radians(30), 0]]))
    assert (found.subject, found.unit) == ("object 0", "degrees")
    assert found.value == pytest.approx(30)


def test_translations_are_in_each_objects_centimetres() -> None:
    found = list(translation_changes(np.array([[0.03, 0.04, 0], [0, 0, 1]]), [100.0, None]))
    assert [(c.value, c.unit) for c in found] == [(pytest.approx(5), "cm"), (1, "scene units")]


def test_the_largest_channel_of_a_colour_with_its_sign() -> None:
    [found] = color_changes(np.array([[0.01, -0.03, 0.02]]))
    assert found.value == pytest.approx(-3)


def test_the_camera_turns_by_signed_angles_and_moves_by_a_distance() -> None:
    found = {c.subject: (c.value, c.unit) for c in camera_changes(np.array([0.1, -0.2, -0.5, 0.3]), 100.0)}
    assert found == {
        "azimuth": (pytest.approx(degrees(0.1)), "degrees"),
        "elevation": (pytest.approx(degrees(-0.2)), "degrees"),
        "roll": (pytest.approx(degrees(0.3)), "degrees"),
        "camera": (pytest.approx(50), "cm"),
    }


def test_a_smaller_object_moves_by_more_of_its_own_centimetres() -> None:
    """The catalogue's chair is 82 cm high; however it is scaled, a move by its own height is one by 82 cm."""

    class Poses:
        def initial(self) -> dict[str, torch.Tensor]:
            return {"translation": torch.zeros(1, 3), "camera": torch.zeros(4)}

    for scale in (1.0, 0.5):
        placed = {"mesh": "furniture/chair", "scale": scale}
        scene = resolve(Scene.model_validate({"objects": [placed], "camera": {"size": [32, 32]}}), LIBRARY)
        vertices = np.concatenate([part.vertices for part in scene.meshes[0].parts])
        corners = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1) @ scene.models[0].T
        height = float(np.ptp(corners[:, 1]))
        moved = {"translation": torch.tensor([[0.0, height, 0.0]]), "camera": torch.tensor([0.0, 0.0, height, 0.0])}
        found = {(c.group, c.measure): c for c in changes(scene, Poses(), moved)}  # type: ignore[arg-type]
        assert found["translation", "distance"].value == pytest.approx(82.0, rel=1e-3)
        assert found["camera", "distance"].value == pytest.approx(82.0, rel=1e-3)
        assert found["camera", "distance"].unit == "cm"
