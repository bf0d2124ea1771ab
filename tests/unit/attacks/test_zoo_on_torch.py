"""ZOO's estimate against autograd through the real renderer and the real network, both in float64."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import cosine_similarity

from scene_attack.attacks.differences import estimate
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import resolve
from scene_attack.targets import registry
from scene_attack.targets.classifier import Classifier
from tests.unit.attacks.small import autograd
from tests.unit.jobs.small import LIBRARY

pytestmark = pytest.mark.slow

SCENE = {
    "objects": [{"mesh": "furniture/soccer-ball", "material": "plastic"}],
    "camera": {"size": [48, 48]},
    "lights": {"environment": {"size": [8, 16]}},
}


def build(group: str, distance_weight: float = 0.1) -> AttackProblem:
    scene = resolve(Scene.model_validate(SCENE), LIBRARY)
    renderer = TorchRenderer(scene, rasterise(scene), tolerance="exact")
    target = registry.load("efficientnet-lite0", torch.float64)
    assert isinstance(target, Classifier)
    target = replace(target, input_size=(48, 48))  # the network takes any size, and float64 is slow
    with torch.no_grad():
        start = {g: v[None] for g, v in renderer.initial().items()}
        first = int(target.logits(renderer.render(start)).argmax())
    goal = ResolvedGoal((first,), None)
    return AttackProblem.of(renderer, target, goal, Limits.of(renderer, (group,)), distance_weight=distance_weight)


def at_random(problem: AttackProblem) -> torch.Tensor:
    """A small perturbation within bounds: at zero the λ term has no slope, and would not be tested."""
    random = torch.Generator().manual_seed(0)
    return problem.limits.clamp(0.5 * torch.randn(problem.layout.total, dtype=torch.float64, generator=random))


@pytest.mark.parametrize("group", ["illumination", "material"])
def test_the_estimate_is_the_gradient(group: str) -> None:
    problem = build(group)
    at = at_random(problem)
    truth = autograd(problem, at)
    free = (problem.initial + at > 1e-3).nonzero().flatten() if group == "illumination" else None
    order = truth.abs().argsort(descending=True)[::6]  # a sixth of the coordinates, large gradients and small
    chosen = order if free is None else order[torch.isin(order, free)]  # at a bound the difference is one-sided
    found = estimate(problem, at, chosen, torch.full((len(chosen),), 1e-4).double(), 0.0).gradients
    assert float(cosine_similarity(found, truth[chosen], dim=0)) > 0.999
    # and of the right size: an estimator scaled by a constant has the same cosine
    assert float(found.norm() / truth[chosen].norm()) == pytest.approx(1, abs=1e-3)


def test_other_coordinates_in_the_batch_change_nothing() -> None:
    problem = build("illumination")
    at = at_random(problem)
    deltas = torch.full((40,), 1e-3).double()
    together = estimate(problem, at, torch.arange(40), deltas, 0.0).gradients
    for chosen in (torch.tensor([7]), torch.arange(30, 40)):
        alone = estimate(problem, at, chosen, deltas[: len(chosen)], 0.0).gradients
        # the network's own sums may be blocked differently for another batch: float64 rounding over 2δ
        torch.testing.assert_close(alone, together[chosen], rtol=1e-6, atol=1e-8)
