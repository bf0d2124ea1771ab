"""Perturbations after which a question has another right answer, by CLEVR's definitions, and which are not allowed."""

from math import pi

import pytest
import torch

from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import record_of
from scene_attack_questions.clevr.records import RGB, ObjectRecord, Rig, SceneRecord, Viewpoint, half_height
from scene_attack_questions.scene_limits import SceneLimits
from tests.unit.questions.iep.seeded import program

RIG = Rig()


def placed(shape: str, color: str, x: float, y: float) -> ObjectRecord:
    centre = (x, y, half_height(shape, "large"))
    attributes = {"shape": shape, "size": "large", "color": color, "material": "rubber", "rotation": 0.0}
    where = {"coords_3d": centre, "pixel_coords": Viewpoint(RIG).pixel(centre)}
    return ObjectRecord.model_validate(attributes | where)


def scene(*colors: str) -> SceneRecord:
    return record_of([placed("cube", colors[0], -1.0, -1.0), placed("sphere", colors[1], 1.0, 1.0)], RIG)


def limits(record: SceneRecord, asked: object, group: str, like: torch.Tensor) -> SceneLimits:
    return SceneLimits([asked], record, describe(record), "pyrender", {group: like})  # type: ignore[list-item]


def test_two_colours_that_may_both_be_read_as_a_third_may_be_the_same() -> None:
    """Does anything have the colour of the cube? Red and gray things that are both nearly brown: maybe."""
    record = scene("red", "gray")
    towards = torch.tensor([[b - a for a, b in zip(RGB[name], RGB["brown"], strict=True)] for name in ("red", "gray")])
    change = {"color": 0.48 * towards.double() / 255}
    asked = program("scene", "filter_shape 0 cube", "unique 1", "same_color 2", "exist 3")
    assert not limits(record, asked, "color", change["color"]).holds(change)


@pytest.mark.parametrize("roll", [pi])
def test_left_and_right_turn_with_the_camera(roll: float) -> None:
    """CLEVR's `left` is the camera's own left in the plane: a camera that is upside down has it on the other side."""
    record = scene("red", "gray")
    asked = program("scene", "filter_shape 0 cube", "unique 1", "relate 2 left", "exist 3")
    change = {"camera": torch.tensor([0.0, 0.0, 0.0, roll]).double()}
    assert any(record.relationships["left"])
    found = limits(record, asked, "camera", change["camera"])
    assert not found.holds(change)
    assert found.fixed["camera"].tolist() == [False, False, False, True]
    assert found.project(change)["camera"].tolist() == [0.0] * 4
