"""The estimate of p-rgf against autograd through the torch renderer and the network, both in float64."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import cosine_similarity

from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.p_rgf import PRGF, projected_gradient, surrogate_gradient
from scene_attack.attacks.problem import AttackProblem, Counts, Surrogate
from scene_attack.attacks.spsa import draw_directions
from scene_attack.rendering.protocol import Renderer
from tests.unit.attacks.small import LinearTarget, stepped
from tests.unit.attacks.test_zoo_on_torch import at_random, autograd, build

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def case() -> AttackProblem:
    return build("material", distance_weight=0.0)


def test_it_is_the_projection_of_the_gradient_whatever_its_batch(case: AttackProblem) -> None:
    """Scale and direction for 1, 8 and 64 directions; what is measured along the first does not depend on the others.

    Along one direction of signs the slope is small, and a difference of ±1e-3 units that straddles a kink of the
    network's ReLU6 is off by up to 2 %: twice the gradient, or a half, is far beyond that.
    """
    at = at_random(case)
    truth, total = autograd(case, at), case.layout.total
    half_steps = torch.full((total,), 1e-3, dtype=torch.float64)
    directions, along = draw_directions("signs", 64, total, 1, 0), []
    for count in (1, 8, 64):
        found, _ = projected_gradient(case, at, directions[:count], half_steps)
        basis, _ = torch.linalg.qr(directions[:count].T)
        projection = basis @ (basis.T @ truth)
        assert float(found.norm() / projection.norm()) == pytest.approx(1, abs=0.02)
        assert float(cosine_similarity(found, projection, dim=0)) > 0.999
        along.append(float(found @ directions[0]))
    assert along == pytest.approx([along[0]] * 3, rel=1e-6)


class Sums(LinearTarget):
    """Linear in an image of any size, in three classes."""

    def __init__(self, renderer: Renderer, seed: int) -> None:
        super().__init__(classes=3)
        height, width = renderer.size
        random = torch.Generator().manual_seed(seed)
        self.weights = 0.01 * torch.randn(height * width * 3, 3, generator=random, dtype=torch.float64)


def test_the_prior_is_the_surrogates_gradient(case: AttackProblem) -> None:
    """Against autograd with the surrogate in the target's place; the loop rounds the image to 8 bits, not the slope."""
    surrogate = Sums(case.renderer, 3)
    goal = ResolvedGoal((1,), None)
    one = replace(case, surrogate=Surrogate(surrogate, goal), counts=Counts())
    alone = AttackProblem.of(case.renderer, surrogate, goal, Limits.of(case.renderer, case.layout.groups))
    at = at_random(case)
    found = surrogate_gradient(one, {}, at, 0)
    truth = autograd(alone, at)
    assert float(found.norm() / truth.norm()) == pytest.approx(1, abs=1e-2)
    assert float(cosine_similarity(found, truth, dim=0)) > 0.9999
    assert one.counts == Counts(queries=0, renders=1, surrogate_queries=1)


def test_with_the_networks_own_gradient_one_difference_finds_the_slope(case: AttackProblem) -> None:
    """A surrogate of the target's weights: the projection onto its gradient is the gradient itself."""
    target = Sums(case.renderer, 3)
    goal = ResolvedGoal((1,), None)
    one = AttackProblem.of(
        case.renderer,
        target,
        goal,
        Limits.of(case.renderer, case.layout.groups, epsilon={"material": 0.16}),
        surrogate=Surrogate(target, goal),
    )
    given = {
        "renderer": "torch",
        "groups": ["material"],
        "epsilon": {"material": 0.16},
        "pairs": 0,
        "surrogate": "other",
    }
    attack = PRGF.model_validate(given)
    moved = stepped(one, attack, attack.init(one), 0)["delta"]
    assert one.counts.queries == 2 + 1  # the loop's own look
    slope = autograd(one, torch.zeros(one.layout.total))
    steep = slope.abs() > 1e-3 * slope.abs().max()
    assert torch.equal(moved[steep].sign(), -slope[steep].sign().to(moved.dtype))  # Adam's first step is of signs
