"""Averages over variations of a scene, on linear problems and through pyrender."""

from dataclasses import replace
from itertools import pairwise
from math import radians

import pytest
import torch
from torch import Tensor

from scene_attack.attacks.attack import ATTACKS
from scene_attack.attacks.differences import ImageDifferences, estimate
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem, differentiate, draw_variation, evaluate
from scene_attack.attacks.request import Expectation
from scene_attack.attacks.run import AttackRun
from scene_attack.rendering.factory import build
from scene_attack.rendering.sensor.photograph import photographed
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import resolve
from tests.unit.attacks.small import NOISY, Ahead, Bowl, FreeRenderer, LinearTarget, Pixels, attack, problem
from tests.unit.jobs.small import LIBRARY

NOISE = Expectation(sensor=NOISY, samples=3)


def quadratic() -> AttackProblem:
    renderer = FreeRenderer()
    bottom = {"a": torch.full((1, 2, 3), 0.2, dtype=torch.float64), "b": torch.full((1, 3), -0.1, dtype=torch.float64)}
    return problem(renderer, Bowl(renderer.render(bottom)[0]), expectation=NOISE, seed=5)


def leads(case: AttackProblem, at: Tensor) -> Tensor:
    """The mean lead of the first class over the scene and its noisy images, written out; `Bowl`'s scores are leads."""
    parameters = case.layout.unflatten((case.initial + at)[None])
    image = case.renderer.render(parameters)
    found = [case.target.logits(image)[0, 0]]
    for number in range(NOISE.samples):
        variation = draw_variation(NOISE, 5, "step", 2, number)
        photograph = photographed(image, variation.sensor, variation.seed)
        found.append(case.target.logits(photograph)[0, 0])
    return torch.stack(found).mean()


def test_the_objective_is_the_mean_over_the_scene_and_its_variations() -> None:
    case = quadratic()
    vectors = 0.02 * torch.arange(27, dtype=torch.float64).reshape(3, 9)
    found = case.objectives(vectors, 2)
    assert case.counts.queries == 3 * (1 + 3)
    torch.testing.assert_close(found, torch.stack([leads(case, vector) for vector in vectors]), rtol=1e-9, atol=1e-12)


def test_the_distance_that_is_weighed_is_the_scenes_own() -> None:
    case = quadratic()
    vectors = torch.full((1, 9), 0.05, dtype=torch.float64)
    plain = case.objectives(vectors, 2)
    distance = (case.render(vectors) - case.original).square().sum()
    weighed = replace(case, distance_weight=2.0).objectives(vectors, 2)
    torch.testing.assert_close(weighed - plain, 2.0 * distance[None], rtol=1e-9, atol=0)


def test_the_gradient_is_the_means() -> None:
    """Against autograd of the sum written out. The loop rounds images to 8 bits, hence the tolerance."""
    case = quadratic()
    at = 0.02 * torch.arange(9, dtype=torch.float64)
    leaf = at.clone().requires_grad_()
    (truth,) = torch.autograd.grad(leads(case, leaf), leaf)
    found = differentiate(case, evaluate(case, at, 2, gradient=True)).gradient
    alone = replace(case, expectation=None)
    own = differentiate(alone, evaluate(alone, at, 2, gradient=True)).gradient
    assert found is not None
    assert own is not None
    assert float((found - truth).norm() / truth.norm()) < 0.02
    assert float((own - truth).norm() / truth.norm()) > 0.04  # the scene's alone is another one


def test_variations_depend_on_seed_and_step_alone_and_fill_the_range() -> None:
    asked = Expectation(azimuth=10, elevation=4, roll=2, distance=0.2, intensity=0.5, sensor=NOISY)
    drawn = [draw_variation(asked, 1, "step", step, 0) for step in range(400)]
    assert drawn[7] == draw_variation(asked, 1, "step", 7, 0)
    assert drawn[7] != draw_variation(asked, 1, "fresh", 7)
    for name, half, centre in (
        ("azimuth", radians(10), 0),
        ("elevation", radians(4), 0),
        ("roll", radians(2), 0),
        ("distance", 0.2, 1),
        ("intensity", 0.5, 1),
    ):
        values = torch.tensor([getattr(one, name) for one in drawn]) - centre
        assert half * 0.97 < float(values.abs().max()) <= half
        assert abs(float(values.mean())) < 4.5 * half / 3**0.5 / 20  # 4.5 standard errors of a uniform's mean


def test_the_numbers_of_a_variation_are_independent() -> None:
    """Correlations of 400 draws of independent numbers have a standard error of 1/20; 4.5 of them are allowed."""
    asked = Expectation(azimuth=10, elevation=4, roll=2, distance=0.2, intensity=0.5)
    names = ("azimuth", "elevation", "roll", "distance", "intensity")
    drawn = [draw_variation(asked, 1, "step", step, 0) for step in range(400)]
    values = torch.tensor([[getattr(one, name) for one in drawn] for name in names], dtype=torch.float64)
    assert float((torch.corrcoef(values) - torch.eye(5)).abs().max()) < 4.5 / 20


def attacked(name: str, expectation: Expectation | None) -> AttackRun:
    renderer = Pixels(dtype=torch.float32)
    given = {"method": name, "renderer": "image", "epsilon": {"image": 0.05}, "steps": 6, "expectation": expectation}
    settings = ATTACKS[name].model_validate(given)
    case = problem(
        renderer, Ahead(renderer), loss=settings.objective, epsilon=settings.epsilon, expectation=expectation
    )
    return attack(case, settings)


@pytest.mark.parametrize("name", ["fgsm", "apgd", "spsa", "cma-es", "p-rgf", "square", "zoo"])
def test_every_kind_of_method_averages_and_repeats_itself(name: str) -> None:
    first, second, plain = attacked(name, NOISE), attacked(name, NOISE), attacked(name, None)
    assert torch.equal(first.stored["image"], second.stored["image"])
    assert all(row.share == 0.0 for row in first.trace)
    assert plain.trace[0].share is None
    assert first.trace[1].queries > plain.trace[1].queries
    assert first.best is not None
    assert first.best.step == max(range(7), key=lambda step: -(first.trace[step].objective or 0.0))


def test_no_samples_attack_the_scene_alone() -> None:
    alone, plain = attacked("apgd", Expectation(sensor=NOISY, samples=0)), attacked("apgd", None)
    assert torch.equal(alone.stored["image"], plain.stored["image"])
    assert (alone.trace[-1].queries, alone.trace[-1].share) == (plain.trace[-1].queries, None)


def test_backtracking_keeps_to_the_limit_of_the_scene_itself() -> None:
    """Under noise no image is within p = 0.02 of the original, not even that of no perturbation."""
    case = problem(Pixels(dtype=torch.float32), expectation=NOISE, perceptibility=0.02)
    whole = torch.full((60,), 0.01)  # p = 0.0173
    [sample, *_] = evaluate(case, whole, 0).samples
    assert torch.equal(sample.delta, whole)
    [sample, *_] = evaluate(case, 10 * whole, 0).samples
    assert 0.019 < float((sample.delta.square().sum() / 20).sqrt()) <= 0.02


class Threshold(LinearTarget):
    """Answers 0 while the mean of the image is below `level`, else 1."""

    def __init__(self, level: float) -> None:
        super().__init__(classes=2)
        self.level = level

    def logits(self, images: Tensor) -> Tensor:
        height = 100 * (images.to(self.dtype).mean(dim=(1, 2, 3)) - self.level)
        return torch.stack([-height, height], dim=1)


def test_it_stops_only_once_sixteen_variations_are_fooled() -> None:
    """Strong noise moves the mean to either side, so that the scene itself is fooled some steps before all are. Of 8
    variations a step those of two steps must be fooled, and one such step alone ends nothing."""
    renderer = Pixels(dtype=torch.float32)
    start = float(renderer.base.mean())
    asked = Expectation(sensor=NOISY, samples=8)
    settings = ATTACKS["fgsm"].model_validate(
        {
            "method": "fgsm",
            "renderer": "image",
            "steps": 60,
            "expectation": asked,
            "learning_rate": {"image": 0.2 / 255},
        }
    )
    case = problem(renderer, Threshold(start + 2.5 / 255), expectation=asked)
    found = attack(case, settings)
    assert found.best is not None
    met = [row.step for row in found.trace if row.advantage < 0]
    assert found.verified
    assert met[0] < found.step
    all_fooled = [row.share == 1.0 for row in found.trace]
    twice = [before and now for before, now in pairwise(all_fooled)]
    assert twice == [False] * (found.step - 1) + [True]
    assert sum(all_fooled) > 2
    assert found.best.step == found.step


SCENE = {
    "objects": [{"mesh": "primitive/cube", "color": [0.8, 0.5, 0.3]}],
    "camera": {"size": [24, 24], "azimuth": 0.5, "elevation": 0.4, "distance": 2.0},
    "lights": {"ambient": 0.3, "points": [{"energy": 20, "position": [1.0, 2.0, 1.5]}]},
}


class Linear(LinearTarget):
    """Linear in an image of 24×24."""

    def __init__(self) -> None:
        super().__init__(scale=0.05, classes=3)
        random = torch.Generator().manual_seed(1)
        self.weights = torch.randn(24 * 24 * 3, 3, generator=random, dtype=torch.float64)


def test_the_mean_gradient_through_pyrender_is_that_of_the_mean_objective() -> None:
    """Differences of images and differences of the mean objective are two ways to the same gradient."""
    renderer = build(resolve(Scene.model_validate(SCENE), LIBRARY), "pyrender", None, ("color", "camera"), "exact")
    target, asked = Linear(), Expectation(azimuth=8, distance=0.1, samples=2)
    case = AttackProblem.of(
        renderer,
        target,
        ResolvedGoal((0,), None),
        Limits.of(renderer, ("color",)),
        seed=3,
        loss="margin",
        expectation=asked,
    )
    case = replace(case, differences=ImageDifferences.at(case, {"color": 0.01}))
    found = differentiate(case, evaluate(case, case.nothing, 0, gradient=True)).gradient
    assert case.counts.queries == 1 + 2
    scene = replace(case, expectation=None)
    own = differentiate(scene, evaluate(scene, case.nothing, 0, gradient=True)).gradient
    assert found is not None
    assert own is not None
    steps = torch.full((3,), 0.01, dtype=torch.float64)
    truth = estimate(case, case.nothing, torch.arange(3), steps, 0.0).gradients
    torch.testing.assert_close(found.double(), truth, rtol=0.02, atol=0.02 * float(truth.abs().max()))
    assert float((own.double() - truth).norm() / truth.norm()) > 0.05
