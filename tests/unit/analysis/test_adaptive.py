"""The attack through the defence, on a linear renderer and network."""

import pytest
import torch

from scene_attack.analysis.records import RerenderingRequest
from scene_attack.analysis.rerendering import LIMIT, attack_through
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import Verifier
from tests.unit.attacks.small import FreeRenderer, LinearRenderer, LinearTarget


class FullRenderer(FreeRenderer):
    """Every image is one of its own: 60 parameters for 60 values, so that a fit reproduces any image."""

    def __post_init__(self) -> None:
        super().__post_init__()
        unit = torch.eye(60, dtype=torch.float64)
        self.weights = {"a": unit[:, :57], "b": unit[:, 57:]}

    def initial(self) -> dict[str, torch.Tensor]:
        return {"a": torch.zeros(57, dtype=self.dtype), "b": torch.zeros(3, dtype=self.dtype)}


class RigidRenderer(FreeRenderer):
    """No parameter changes the image, so that every fit ends at the scene's own image."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.weights = {group: 0 * weight for group, weight in self.weights.items()}


FIT = RerenderingRequest(optimiser="adam", rate=3e-3, steps=60)


def attacked(renderer: LinearRenderer, steps: int):  # type: ignore[no-untyped-def]
    verifier = Verifier(renderer, LinearTarget(scale=1.0))
    original = verifier.image({})
    first = int(verifier.logits(original).argmax())
    ticks: list[tuple[int, int]] = []
    found = attack_through(
        verifier, ResolvedGoal((first,), None), original, fit=FIT, steps=steps, tick=lambda *tick: ticks.append(tick)
    )
    assert all(done < of for done, of in ticks)
    assert len(ticks) == (found.steps + 1) * (FIT.steps + 2)
    return found


def test_a_defence_that_reproduces_the_image_is_no_defence() -> None:
    """The fit is the identity up to its error, so the straight-through gradient is the true one."""
    found = attacked(FullRenderer(), 40)
    assert found.fooled
    assert found.image.label == found.rerendered.label
    assert 0 < found.perceptibility <= 3**0.5 * LIMIT + 1e-9
    assert found.goal_probability[-1] < found.goal_probability[0]


def test_a_defence_that_ignores_the_image_cannot_be_fooled() -> None:
    found = attacked(RigidRenderer(), 5)
    assert not found.fooled
    assert found.steps == 5
    assert found.goal_probability == pytest.approx([found.goal_probability[0]] * 6)
    assert found.perceptibility > 0


def test_an_attack_of_many_steps_ends_at_the_limit() -> None:
    """Against a defence that ignores the image the gradient is always the same, and no value of the start is near 0 or
    1: after 15 steps each value is off by exactly U, so that p is √3 · U."""
    found = attacked(RigidRenderer(), 15)
    assert found.perceptibility == pytest.approx(3**0.5 * LIMIT, rel=1e-6)
