"""The share of fresh variations that are fooled, against a count written out."""

import pytest
import torch
from torch import Tensor

from scene_attack.analysis.expectation import held_over, survival
from scene_attack.analysis.records import SurvivalRequest
from scene_attack.analysis.verdict import wilson
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import derived, draw_sensor, draw_variation
from scene_attack.attacks.request import Expectation
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.sensor.photograph import photographed
from tests.unit.attacks.small import NOISY, LinearTarget, Pixels


class Brightness(LinearTarget):
    """Answers 0 below the brightness `low`, 1 up to `high`, and 2 beyond."""

    def __init__(self, low: float, high: float) -> None:
        super().__init__(classes=3)
        self.limits = torch.tensor([low, high], dtype=torch.float64)

    def logits(self, images: Tensor) -> Tensor:
        level = torch.bucketize(images.double().mean(dim=(1, 2, 3)), self.limits)
        return 5 * torch.nn.functional.one_hot(level, 3).double()


ASKED = Expectation(sensor=NOISY, checks=60, samples=1)


@pytest.mark.parametrize(("goal", "wanted"), [(ResolvedGoal((0,), None), (1, 2)), (ResolvedGoal((0,), 2), (2,))])
def test_only_variations_that_were_right_count(goal: ResolvedGoal, wanted: tuple[int, ...]) -> None:
    renderer = Pixels(dtype=torch.float32)
    middle = float(renderer.base.mean())
    target = Brightness(middle + 0.004, middle + 0.012)
    moved = torch.full((4, 5, 3), 0.01)
    right = fooled = 0
    for number in range(60):
        variation = draw_variation(ASKED, 9, "fresh", number)
        answers = []
        for perturbation in (0.0, moved):
            image = photographed((renderer.base + perturbation).float()[None], variation.sensor, variation.seed)
            answers.append(int(target.logits((image * 255).round() / 255).argmax()))
        right += answers[0] == 0
        fooled += answers[0] == 0 and answers[1] in wanted
    assert 0 < fooled < right < 60
    verifier = Verifier(renderer, target)
    found = held_over(verifier, goal, (0,), {"image": moved}, ASKED, seed=9)
    assert (found.variations, found.right, found.fooled) == (60, right, fooled)
    assert found.share == fooled / right
    assert found.interval == wilson(fooled, right)
    assert found.wrong_interval == wilson(60 - right, 60)
    assert verifier.counts.queries == 60 + right
    assert found.views == []  # noise is seen from one view


def test_each_camera_takes_both_images_with_the_same_noise_and_no_other_camera_has_it() -> None:
    """The answers hang on the noise: the network looks for the brightness of single pixels."""
    asked = SurvivalRequest.model_validate(NOISY.model_dump() | {"iso": 102_400, "draws": 40})
    random = torch.Generator().manual_seed(0)
    original = 0.3 + 0.4 * torch.rand(4, 5, 3, generator=random)
    attacked = original + 0.02
    middle = float(original.mean())
    target = Brightness(middle, middle + 0.01)
    right = fooled = 0
    for number in range(40):
        sensor, noise = draw_sensor(asked, 5, "survival", number), derived(5, "survival noise", number)
        first, second = (
            int(target.logits((photographed(image[None], sensor, noise) * 255).round() / 255).argmax())
            for image in (original, attacked)
        )
        right += first == 0
        fooled += first == 0 and second != 0
    assert 0 < fooled < right < 40
    verifier = Verifier(Pixels(dtype=torch.float32), target)
    found = survival(verifier, ResolvedGoal((0,), None), (0,), original, attacked, asked, seed=5)
    assert (found.variations, found.right, found.fooled) == (40, right, fooled)


def test_a_scene_that_is_right_nowhere_has_no_share() -> None:
    renderer = Pixels(dtype=torch.float32)
    found = held_over(
        Verifier(renderer, Brightness(0.0, 0.01)), ResolvedGoal((0,), None), (0,), renderer.initial(), ASKED, seed=0
    )
    assert (found.right, found.share, found.interval, found.wrong_share) == (0, None, None, 1.0)
