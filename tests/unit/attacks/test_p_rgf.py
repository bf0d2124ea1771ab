from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from scene_attack.attacks.differences import ImageDifferences
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.p_rgf import PRGF, projected_gradient, surrogate_gradient
from scene_attack.attacks.problem import AttackProblem, Surrogate
from scene_attack.attacks.request import Expectation
from scene_attack.attacks.spsa import draw_directions
from scene_attack.rendering.protocol import InactiveCoordinate
from tests.unit.attacks.small import (
    NOISY,
    Ahead,
    FreeRenderer,
    LinearRenderer,
    LinearTarget,
    OpaqueCurvedRenderer,
    Pixels,
    attack,
    autograd,
    problem,
    resumed,
    smooth,
    stepped,
)


def projection(gradient: torch.Tensor, directions: torch.Tensor, half_steps: torch.Tensor) -> torch.Tensor:
    """The orthogonal projection by QR, in units of the half-steps."""
    basis, _ = torch.linalg.qr(directions.T)
    return basis @ (basis.T @ (gradient * half_steps)) / half_steps


@pytest.mark.parametrize("count", [1, 4, 8])
def test_the_estimate_is_the_projection_of_autograds_gradient(count: int) -> None:
    case = smooth()
    at = 0.01 * torch.arange(9, dtype=torch.float64)
    half_steps = case.layout.spread({"a": 1e-3, "b": 3e-3})
    directions = draw_directions("gaussian", count, 9, 7, 0)
    found, still = projected_gradient(case, at, directions, half_steps)
    torch.testing.assert_close(found, projection(autograd(case, at), directions, half_steps), rtol=1e-6, atol=1e-9)
    assert still == 0
    assert case.counts.queries == 2 * count


@pytest.mark.parametrize("count", [9, 64])
def test_directions_that_span_the_space_give_the_gradient_itself(count: int) -> None:
    case = smooth()
    at = 0.01 * torch.arange(9, dtype=torch.float64)
    half_steps = case.layout.spread({"a": 1e-3, "b": 3e-3})
    directions = draw_directions("gaussian", count, 9, 7, 0)
    found, _ = projected_gradient(case, at, directions, half_steps)
    torch.testing.assert_close(found, autograd(case, at), rtol=1e-6, atol=1e-9)


def test_at_a_bound_the_estimate_agrees_with_what_really_moved() -> None:
    """Group b begins at its lower bound, so a side is cut off at different lengths by coordinate."""
    case = problem(LinearRenderer())
    at, half_steps = torch.zeros(9, dtype=torch.float64), case.layout.spread({"a": 1e-4, "b": 1e-4})
    directions = draw_directions("gaussian", 32, 9, 3, 0)
    found, _ = projected_gradient(case, at, directions, half_steps)
    torch.testing.assert_close(found, autograd(case, at), rtol=1e-6, atol=1e-8)


def test_a_direction_along_which_nothing_changes_is_counted() -> None:
    case = smooth()
    directions = torch.cat([draw_directions("signs", 2, 9, 0, 0), torch.zeros(1, 9, dtype=torch.float64)])
    at, half_steps = torch.zeros(9, dtype=torch.float64), case.layout.spread({"a": 1e-3, "b": 1e-3})
    found, still = projected_gradient(case, at, directions, half_steps)
    assert still == 1
    assert bool(found.isfinite().all())


def with_surrogate(target: LinearTarget, surrogate: LinearTarget, **settings: object) -> AttackProblem:
    renderer = Pixels(dtype=torch.float32)
    case = problem(renderer, target, epsilon={"image": 0.05}, **settings)
    return replace(case, surrogate=Surrogate(surrogate, ResolvedGoal(case.goal.leave, None)))


def settings(**given: object) -> PRGF:
    return PRGF.model_validate({"renderer": "image", "epsilon": {"image": 0.05}} | given)


def test_the_surrogates_queries_are_counted_apart() -> None:
    renderer = Pixels(dtype=torch.float32)
    case = with_surrogate(Ahead(renderer), Ahead(renderer))
    found = attack(case, settings(pairs=3, surrogate="other"), steps=4)
    assert found.settings == {"surrogate": {}}
    assert case.counts.queries == 4 * 2 * (3 + 1) + 5  # both sides of each direction, and the loop's looks
    assert case.counts.surrogate_queries == 4
    assert case.counts.renders == case.counts.queries + 4 + 1  # the surrogate's looks, and the original


def test_a_prior_that_is_the_gradient_needs_no_random_directions() -> None:
    """A network of the same weights: after one step of two queries the objective falls as far as the gradient says."""
    renderer = Pixels(dtype=torch.float32)
    target = Ahead(renderer)
    guided, blind = with_surrogate(target, target), problem(renderer, target, epsilon={"image": 0.05})
    found = {}
    for name, case, pairs in (("guided", guided, 0), ("blind", blind, 1)):
        given = settings(pairs=pairs, surrogate="other")
        state = stepped(case, given, given.init(case), 0)
        before, after = case.objectives(torch.stack([case.start, state["delta"]])).tolist()
        found[name] = before - after
    steepest = float(autograd(guided, torch.zeros(60)).abs().sum()) * 0.05 / 4
    assert found["guided"] == pytest.approx(steepest, rel=0.02)
    assert found["blind"] < 0.6 * steepest


def test_the_priors_images_are_as_far_off_as_random_ones_and_along_the_gradient() -> None:
    """In units of the half-steps the surrogate's direction is its gradient, as long as a direction of signs: √9."""
    case = problem(FreeRenderer(), epsilon={"a": 0.1, "b": 0.1})
    case = replace(case, surrogate=Surrogate(case.target, case.goal))
    half_steps = {"a": 1e-3, "b": 4e-3}
    given = PRGF.model_construct(pairs=0, surrogate="other", delta=half_steps, learning_rate={"a": 0.01, "b": 0.01})
    rendered, render = [], case.renderer.render

    def recording(parameters: Any) -> torch.Tensor:
        rendered.append(torch.cat([parameters[group].detach().flatten(1) for group in case.layout.groups], dim=1))
        return render(parameters)

    case.renderer.render = recording  # type: ignore[method-assign]
    stepped(case, given, given.init(case), 0)
    sides = rendered[-1]
    units = case.layout.spread(half_steps)
    direction = margin_gradient(case) * units
    moves = units * direction / direction.norm() * 3
    torch.testing.assert_close(sides, torch.stack([moves, -moves]), rtol=1e-4, atol=1e-12)


def margin_gradient(case: AttackProblem) -> torch.Tensor:
    """The gradient of the margin of the labels to leave over the largest other, at the scene itself, by autograd."""
    leaf = torch.zeros(9, dtype=torch.float64, requires_grad=True)
    scores = case.target.logits(case.renderer.render(case.layout.unflatten(leaf[None])))[0]
    [first] = case.goal.leave
    others = torch.cat([scores[:first], scores[first + 1 :]])
    (gradient,) = torch.autograd.grad(scores[first] - others.max(), leaf)
    return gradient


def test_a_prior_without_direction_is_left_out() -> None:
    class Blank(LinearTarget):
        def logits(self, images: torch.Tensor) -> torch.Tensor:
            return 0.0 * super().logits(images)

    renderer = Pixels(dtype=torch.float32)
    case = with_surrogate(Ahead(renderer), Blank())
    attack(case, settings(pairs=2, surrogate="other"), steps=1)
    assert case.counts.queries == 4 + 2


def test_the_surrogates_gradient_is_that_of_this_steps_variations_alone() -> None:
    """A coordinate counts as inactive if it is so under each of them. A resumed attack knows no earlier ones."""

    class Hides(OpaqueCurvedRenderer):
        def __init__(self) -> None:
            super().__init__()
            self.asked = 0

        def inactive(self, parameters: Any, reach: Any) -> Any:
            self.asked += 1
            return (InactiveCoordinate("b", 1, "b 1", "hidden"),)

    renderer = Hides()
    expectation = Expectation(sensor=NOISY, samples=3)
    case = problem(renderer, LinearTarget(), expectation=expectation)
    case = replace(case, surrogate=Surrogate(LinearTarget(), ResolvedGoal(case.goal.leave, None)))
    differences = ImageDifferences.at(case, {"a": 1e-3, "b": 1e-3})
    state = {"surrogate_half_steps": differences.half_steps, "surrogate_inactive": differences.inactive}

    def asked(steps: list[int]) -> int:
        for step in steps:
            renderer.asked = 0
            surrogate_gradient(case, state, case.nothing, step)
        return renderer.asked

    assert asked([3]) == asked([2, 3])


def test_no_direction_at_all_is_refused() -> None:
    with pytest.raises(ValueError, match="pairs: without a surrogate"):
        settings(pairs=0)
    assert settings(pairs=0, surrogate="other").guide == "other"


@pytest.mark.parametrize("kind", [Pixels, OpaqueCurvedRenderer])
def test_resumed_it_ends_in_the_same_bits(kind: type[LinearRenderer], tmp_path: Path) -> None:
    """Also where the half-steps of the surrogate's gradient are measured."""
    renderer = kind(dtype=torch.float32)
    limits = dict.fromkeys(renderer.groups, 0.05)
    given = PRGF.model_construct(pairs=2, surrogate="other", delta=limits, learning_rate=limits)

    def build() -> AttackProblem:
        case = problem(renderer, Ahead(renderer), epsilon=limits)
        return replace(case, surrogate=Surrogate(Ahead(renderer), ResolvedGoal(case.goal.leave, None)))

    resumed(build, given, tmp_path / "checkpoint", steps=6)
