"""Transfer to other networks, and scenes as perturbations describe them."""

import pytest
import torch

from scene_attack.analysis.transfer import Wanted, indices, shown_to
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.runs.described import can_carry, described
from tests.unit.analysis.test_attribution import Built, Pixels
from tests.unit.jobs.small import spec


def grey(value: int) -> torch.Tensor:
    image = torch.zeros(3, 3, 3, dtype=torch.uint8)
    image[0, 0] = value
    return image


RIGHT, WRONG = frozenset([0]), frozenset([1])


@pytest.mark.parametrize(
    ("weight", "offset", "truth", "right_before", "outcome"),
    [
        (-1.0, 6.5, RIGHT, True, "fooled"),  # yes, then no
        (1.0, 6.5, RIGHT, True, "held"),  # yes, then yes
        (-1.0, -6.5, RIGHT, False, "still-wrong"),  # no before and after
        (-1.0, 6.5, WRONG, False, "became-right"),  # yes, then no, which is right
        (-1.0, 6.5, frozenset(), None, "changed"),
        (1.0, 6.5, frozenset(), None, "held"),
    ],
)
def test_only_a_network_that_was_right_is_fooled(
    weight: float, offset: float, truth: frozenset[int], right_before: bool | None, outcome: str
) -> None:
    verifier = Verifier(Pixels(), Built([weight] + 8 * [0.0], {}, offset))
    found = shown_to(verifier, Wanted(truth, None, (), 0.0), grey(0), grey(20))
    assert (found.right_before, found.outcome) == (right_before, outcome)
    assert found.target == "built"


def test_the_labels_to_leave_are_the_truth_or_those_that_mean_the_first_answer() -> None:
    wanted = Wanted(frozenset([1, 2]), None, (frozenset([3, 4]),), 0.25)
    assert wanted.goal(2) == ResolvedGoal((1, 2), None, 0.25)
    assert wanted.goal(3) == ResolvedGoal((3, 4), None, 0.25)
    assert wanted.goal(0) == ResolvedGoal((0,), None, 0.25)
    assert indices(["cat", "dog"], ("bird", "dog", "cat", "cow")) == {1, 2}


def test_poses_and_colours_are_parts_of_the_scene_lights_are_not() -> None:
    scene = spec().scene
    perturbation = {
        "illumination": torch.ones(5, dtype=torch.float64),
        "color": torch.tensor([[-0.25, 0.0, -0.5]], dtype=torch.float64),
        "rotation": torch.tensor([[0.0, 0.5, 0.0]], dtype=torch.float64),
    }
    moved = described(scene, perturbation)
    assert moved.objects[0].color == (0.75, 1.0, 0.5)
    assert moved.objects[0].rotation == (0.0, 0.5, 0.0)
    assert moved.objects[0].translation == scene.objects[0].translation
    assert moved.lights == scene.lights


def test_the_cameras_place_and_roll_are_carried() -> None:
    scene = spec().scene
    change = torch.tensor([0.1, -0.05, 0.2, 0.3], dtype=torch.float64)
    moved = described(scene, {"camera": change})
    camera = scene.camera
    assert moved.camera.azimuth == pytest.approx(camera.azimuth + 0.1)
    assert moved.camera.elevation == pytest.approx(camera.elevation - 0.05)
    assert moved.camera.distance == pytest.approx(camera.distance + 0.2)
    assert moved.camera.roll == pytest.approx(0.3)
    assert moved.objects == scene.objects


@pytest.mark.parametrize(
    ("renderer", "groups"), [("torch", ("illumination",)), ("image", ("image",)), ("pyrender", ("illumination",))]
)
def test_some_groups_are_no_fields_of_a_scene(renderer: str, groups: tuple[str, ...]) -> None:
    assert not can_carry(renderer, groups)


@pytest.mark.parametrize("renderer", ["pyrender", "blender", "mitsuba", "stock-pyrender"])
def test_every_renderer_with_the_groups_of_pyrender_describes_a_scene(renderer: str) -> None:
    """Those of plug-ins are asked by their groups, and not by their names."""
    if renderer not in RENDERERS:
        pytest.skip("the plug-in is not installed")
    assert can_carry(renderer, ("illumination", "translation"))
