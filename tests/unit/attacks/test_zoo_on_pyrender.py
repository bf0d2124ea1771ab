"""ZOO through the real pyrender renderer: coordinates that change nothing are left out, and only those."""

import torch

from services.attacks.differences import estimate
from services.attacks.goal import ResolvedGoal
from services.attacks.problem import AttackProblem
from services.attacks.zoo import Zoo, ZooMethod
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.description import Lights, PointLight
from tests.unit.attacks.small import LinearTarget
from tests.unit.rendering.shapes import mesh, placed, quad, scene

BEHIND = PointLight(energy=15.0, position=(0.3, 0.2, -1.0))
BEFORE = PointLight(energy=15.0, position=(0.3, 0.2, 1.5))
SKIPPED = {"point 1 energy", "point 1 x", "point 1 y", "point 1 z"}


def problem(*lights: PointLight) -> AttackProblem:
    description = scene((4, 5), lights=Lights(ambient=0.3, points=lights))
    renderer = PyrenderRenderer(placed(description, mesh(quad(0.5, color=(0.4, 0.5, 0.6, 1)))))
    groups = renderer.plan.groups
    return AttackProblem(renderer, LinearTarget(), ResolvedGoal((0,), None), groups)  # type: ignore[arg-type]


def settings(**changes: object) -> Zoo:
    values = {"coordinates": 128, "delta": 1e-2, "learning_rate": 2e-3, "steps": 10}
    return Zoo.model_construct(**(values | changes))  # type: ignore[arg-type]


def test_skipped_coordinates_are_listed_and_not_asked_about() -> None:
    case = problem(BEFORE, BEHIND)
    method = ZooMethod(settings(), case)
    found = method.start(case)
    assert {one["coordinate"] for one in found["skipped"]} == SKIPPED  # type: ignore[attr-defined]
    asked = case.queries
    method.advance(case, case.view(method.perturbation), 0)
    assert case.queries - asked == 2 * (18 - 4)
    assert (method.delta[5:9] == 0).all()


def test_the_budget_goes_to_the_others() -> None:
    case = problem(BEFORE, BEHIND)
    method = ZooMethod(settings(coordinates=14), case)
    method.start(case)
    asked = case.queries
    method.advance(case, case.view(method.perturbation), 0)
    assert case.queries - asked == 28
    assert (method.moves > 0).sum() + (method.delta == 0).sum() >= 14


def test_skipping_loses_nothing_and_keeping_is_needed() -> None:
    """Every skipped coordinate has a gradient of zero; leaving a kept one out would lose its gradient."""
    case = problem(BEFORE, BEHIND)
    method = ZooMethod(settings(), case)
    method.start(case)
    total = case.layout.total
    gradients = estimate(case, torch.zeros(total), torch.arange(total), method.half_steps, 0.0).gradients
    assert (gradients[method.inactive] == 0).all()
    kept = gradients[~method.inactive]
    # of a square that is centred in view and faces the camera: turning it about z or x and y is seen, like all else
    assert (kept != 0).sum() >= 12


def test_a_coordinate_that_comes_to_matter_is_taken_up() -> None:
    case = problem(BEFORE, BEHIND)
    method = ZooMethod(settings(), case)
    method.start(case)
    method.delta[case.layout.starts["translation"] + 2] = -2.0  # the square moves behind the light
    asked = case.queries
    method.advance(case, case.view(method.perturbation), 0)
    assert case.queries - asked == 36


def test_what_is_skipped_survives_a_restart() -> None:
    case = problem(BEFORE, BEHIND)
    whole, rest = ZooMethod(settings(coordinates=5), case), ZooMethod(settings(coordinates=5), case)
    whole.start(case)
    whole.advance(case, case.view(whole.perturbation), 0)
    rest.load({name: value.clone() for name, value in whole.state().items()})
    for method in (whole, rest):
        method.advance(case, case.view(method.perturbation), 1)
    assert torch.equal(whole.delta, rest.delta)
    assert whole.inactive.any()
