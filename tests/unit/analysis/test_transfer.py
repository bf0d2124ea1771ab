"""Transfer to other networks and to another renderer."""

import pytest
import torch

from services.analysis.transfer import carried_goal, shown_to
from services.attacks.goal import ResolvedGoal
from services.attacks.verifier import Verifier
from services.errors import InvalidRequest
from services.pipeline.described import can_carry, described
from tests.unit.analysis.test_attribution import Built, Pixels
from tests.unit.jobs.small import spec


def grey(value: int) -> torch.Tensor:
    image = torch.zeros(3, 3, 3, dtype=torch.uint8)
    image[0, 0] = value
    return image


def test_a_goal_is_carried_by_the_names_of_its_labels() -> None:
    labels, others = ("cat", "dog", "bird"), ("bird", "cat")
    assert carried_goal(ResolvedGoal(0, None), labels, others) == ResolvedGoal(1, None)
    assert carried_goal(ResolvedGoal(0, 2), labels, others) == ResolvedGoal(1, 0)
    assert carried_goal(ResolvedGoal(1, None), labels, others) is None
    assert carried_goal(ResolvedGoal(0, 1), labels, others) is None


@pytest.mark.parametrize(
    ("weight", "offset", "goal", "was_right", "fooled"),
    [
        (-1.0, 6.5, ResolvedGoal(0, None), True, True),  # yes, then no
        (1.0, 6.5, ResolvedGoal(0, None), True, False),  # yes, then yes
        (-1.0, -6.5, ResolvedGoal(0, None), False, False),  # no before the attack: not fooled
        (-1.0, 6.5, None, None, None),  # no label of that name
    ],
)
def test_only_a_network_that_was_right_is_fooled(
    weight: float, offset: float, goal: ResolvedGoal | None, was_right: bool | None, fooled: bool | None
) -> None:
    verifier = Verifier(Pixels(), Built([weight] + 8 * [0.0], {}, offset))
    found = shown_to(verifier, goal, grey(0), grey(20), "torch")
    assert (found.was_right, found.fooled) == (was_right, fooled)
    assert found.changed == (found.before.label != found.after.label)
    assert found.target == "built"


def test_poses_and_colours_are_parts_of_the_scene_lights_are_not() -> None:
    scene = spec().scene
    perturbation = {
        "illumination": torch.ones(5, dtype=torch.float64),
        "color": torch.tensor([[-0.25, 0.0, -0.5]], dtype=torch.float64),
        "rotation": torch.tensor([[0.0, 0.5, 0.0]], dtype=torch.float64),
    }
    moved, carried, left = described(scene, "pyrender", perturbation)
    assert (carried, left) == (["color", "rotation"], ["illumination"])
    assert moved.objects[0].color == (0.75, 1.0, 0.5)
    assert moved.objects[0].rotation == (0.0, 0.5, 0.0)
    assert moved.objects[0].translation == scene.objects[0].translation
    assert moved.lights == scene.lights


@pytest.mark.parametrize(
    ("renderer", "groups"), [("torch", ("illumination",)), ("image", ("image",)), ("pyrender", ("illumination",))]
)
def test_what_no_scene_describes_is_refused(renderer: str, groups: tuple[str, ...]) -> None:
    assert not can_carry(renderer, groups)
    with pytest.raises(InvalidRequest, match="no attacked group"):
        described(spec().scene, renderer, {group: torch.zeros(1) for group in groups})
