"""Attacks under a constraint that is no box: nothing outside of it is viewed, and what it fixes is never moved."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from scene_attack.attacks.cma_es import CMAES
from scene_attack.attacks.differences import estimate, measure_half_steps
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.zoo import ZOO
from scene_attack.rendering.protocol import Parameters
from tests.unit.attacks.small import CurvedRenderer, FreeRenderer, LinearTarget, attack, problem


@dataclass
class Ball:
    """Group "a" stays in a ball, and its coordinate (1, 2) stays where it is. Keeps what it was asked about."""

    radius: float = 0.05
    asked: list[Parameters] = field(default_factory=list)

    @property
    def fixed(self) -> dict[str, Tensor]:
        mask = torch.zeros(2, 3, dtype=torch.bool)
        mask[1, 2] = True
        return {"a": mask}

    def holds(self, perturbation: Parameters) -> bool:
        self.asked.append(perturbation)
        return float(perturbation["a"].norm()) <= self.radius * (1 + 1e-6)

    def project(self, perturbation: Parameters) -> Parameters:
        size = float(perturbation["a"].norm())
        return perturbation | {"a": perturbation["a"] * min(1.0, self.radius / max(size, 1e-30))}


class Seen(FreeRenderer):
    """Keeps the norm of group "a" of every image, but those of the noise, and whether (1, 2) moved."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.norms: list[float] = []
        self.moved = False

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        if "a" in parameters:
            self.norms += parameters["a"].flatten(1).norm(dim=1).tolist()
            self.moved |= bool(parameters["a"][:, 1, 2].any())
        return super().render(parameters)


def zoo(**settings: object) -> ZOO:
    made = ZOO.model_construct(
        coordinates=9, delta=1e-3, learning_rate={"a": 0.05, "b": 0.01}, weight=0.0, steps=12, method="zoo"
    )
    return made.model_copy(update=settings)


def test_zoo_asks_for_no_image_outside() -> None:
    renderer, constraint = Seen(), Ball()
    case = problem(renderer, LinearTarget(scale=0.1), constraint=constraint)
    out_of_reach = replace(case, goal=ResolvedGoal(case.goal.leave, None, 0.999))  # so that all steps are taken
    found = attack(out_of_reach, zoo(), steps=12)
    assert max(renderer.norms) <= 0.05 * (1 + 1e-5)
    assert max(renderer.norms) > 0.04  # the limit was reached
    assert not renderer.moved
    assert bool(found.stored["b"].all())  # other groups are free


def test_cma_es_asks_for_no_image_outside() -> None:
    renderer, constraint = Seen(), Ball()
    limits = {"a": 0.5, "b": 0.2}
    case = problem(renderer, LinearTarget(scale=0.1), constraint=constraint, epsilon=limits)
    settings = CMAES.model_construct(
        population=6, spread={g: v / 3 for g, v in limits.items()}, epsilon=limits, steps=5, method="cma-es"
    )
    attack(case, settings)
    assert max(renderer.norms) <= 0.05 * (1 + 1e-5)
    assert not renderer.moved


def test_a_difference_at_the_limit_is_taken_on_the_side_that_is_allowed() -> None:
    constraint = Ball()
    case = problem(CurvedRenderer(), constraint=constraint)
    at = torch.zeros(9, dtype=torch.float64)
    at[0] = 0.05
    found = estimate(case, at, torch.tensor([0]), torch.tensor([1e-4], dtype=torch.float64), 0.0)
    free = problem(CurvedRenderer())
    expected = estimate(free, at, torch.tensor([0]), torch.tensor([1e-6], dtype=torch.float64), 0.0)
    assert float(found.gradients[0]) == pytest.approx(float(expected.gradients[0]), rel=1e-2)


def test_half_steps_are_measured_within_and_without_what_is_fixed() -> None:
    renderer = Seen()
    case = problem(renderer, constraint=Ball())
    renderer.norms.clear()
    chosen = measure_half_steps(case, torch.full((9,), 0.3), 0.0, probes=6)
    assert set(chosen) == {"a", "b"}
    assert max(renderer.norms) <= 0.05 * (1 + 1e-5)
    assert not renderer.moved


class OpaqueSeen(Seen):
    """The same without gradients."""

    differentiable = False

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        return super().render({group: value.detach() for group, value in parameters.items()}).detach()


def test_differences_of_images_are_taken_within() -> None:
    renderer = OpaqueSeen()
    case = problem(renderer, LinearTarget(scale=0.1), constraint=Ball())
    settings = FGSM.model_construct(
        learning_rate={"a": 0.03, "b": 0.01}, momentum=0.9, weight_decay=0.0, steps=6, method="fgsm"
    )
    attack(case, settings)
    assert 0.04 < max(renderer.norms) <= 0.05 * (1 + 1e-5)
    assert not renderer.moved


def test_backtracking_ends_within_the_constraint() -> None:
    constraint = Ball()
    case = problem(FreeRenderer(), constraint=constraint, perceptibility=1e-3)
    vector = torch.full((1, 9), 0.2, dtype=torch.float64)
    [found] = case.feasible(vector)
    assert constraint.holds(case.layout.unflatten(found))
    image = case.render(found[None])
    p = (image - case.original).square().sum(-1).mean().sqrt()
    assert 0.9e-3 < float(p) <= 1e-3
