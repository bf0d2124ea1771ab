from collections.abc import Mapping

import pytest
import torch
from torch import Tensor

from services.attacks.differences import CANDIDATES, estimate
from services.attacks.zoo import Zoo, ZooMethod
from tests.unit.attacks.small import CurvedRenderer, FreeRenderer, LinearRenderer, LinearTarget, autograd, problem


def settings(**changes: object) -> Zoo:
    values = {"coordinates": 128, "delta": 1e-4, "learning_rate": 2e-3, "steps": 10}
    return Zoo.model_construct(**(values | changes))  # type: ignore[arg-type]


def test_with_all_coordinates_it_is_adam_on_the_true_gradient() -> None:
    """torch.optim.Adam, fed by autograd, is the reference: nothing of the estimate or the update is shared."""
    case = problem(weight=0.3)
    method = ZooMethod(settings(), case)
    method.start(case)
    leaf = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    adam = torch.optim.Adam([leaf], lr=2e-3)
    for step in range(5):
        images = case.renderer.render({"a": leaf[None], "b": method.perturbation["b"].double()[None]})
        value = case.goal.advantage(case.target.logits(images)).sum()
        value = value + 0.3 * (images - case.original).square().sum()
        (leaf.grad,) = torch.autograd.grad(value, leaf)
        method.advance(case, case.view(method.perturbation), step)
        adam.step()
        torch.testing.assert_close(method.perturbation["a"].double(), leaf.detach(), rtol=1e-4, atol=1e-7)


def test_only_chosen_coordinates_move_and_the_choice_is_the_seeds() -> None:
    moved = []
    for seed in (0, 0, 1):
        case = problem(seed=seed)
        method = ZooMethod(settings(coordinates=3), case)
        method.start(case)
        method.advance(case, case.view(method.perturbation), 0)
        assert int((method.moves > 0).sum()) <= 3
        moved.append(method.delta.clone())
    assert torch.equal(moved[0], moved[1])
    assert not torch.equal(moved[0], moved[2])


def test_coordinates_below_the_noise_are_counted_and_left_alone() -> None:
    renderer = LinearRenderer()
    renderer.weights["b"] *= 0
    case = problem(renderer)
    method = ZooMethod(settings(), case)
    method.start(case)
    assert method.advance(case, case.view(method.perturbation), 0) == 3
    assert (method.moves[6:] == 0).all()
    assert (method.delta[6:] == 0).all()


def test_a_heavy_weight_keeps_the_image_closer() -> None:
    distances = []
    for weight in (0.0, 100.0):
        case = problem(weight=weight)
        method = ZooMethod(settings(), case)
        method.start(case)
        for step in range(60):
            method.advance(case, case.view(method.perturbation), step)
        distances.append(float((case.view(method.perturbation).images - case.original).norm()))
    assert distances[1] < 0.5 * distances[0]


def test_measured_steps_are_reported() -> None:
    case = problem()
    found = ZooMethod(settings(delta="measured"), case).start(case)
    assert set(found) == {"delta", "noise", "skipped"}
    assert set(found["delta"]) == {"a", "b"}  # type: ignore[call-overload]


def test_its_state_continues_where_it_was() -> None:
    case = problem()
    whole, half, rest = (ZooMethod(settings(coordinates=4), case) for _ in range(3))
    whole.start(case)
    half.start(case)
    for step in range(6):
        whole.advance(case, case.view(whole.perturbation), step)
    for step in range(3):
        half.advance(case, case.view(half.perturbation), step)
    rest.load({name: value.clone() for name, value in half.state().items()})
    for step in range(3, 6):
        rest.advance(case, case.view(rest.perturbation), step)
    assert torch.equal(whole.delta, rest.delta)


def test_every_step_draws_coordinates_of_its_own() -> None:
    case = problem()
    method = ZooMethod(settings(coordinates=3), case)
    method.start(case)
    for step in range(20):
        before = method.moves.clone()
        method.advance(case, case.view(method.perturbation), step)
        assert int((method.moves - before).sum()) <= 3
    assert (method.moves > 0).all()  # of 9 coordinates; one that is drawn with 1/3 is missed 20 times with 3e-4
    assert len(method.moves.unique()) > 1


def test_each_group_has_its_own_half_step_and_rate() -> None:
    """Adam's first step is the rate times the gradient's sign, whatever its length."""
    rates, deltas = {"a": 0.01, "b": 0.03}, {"a": 2e-3, "b": 5e-4}
    case = problem(FreeRenderer(), weight=0.3)
    method = ZooMethod(settings(learning_rate=rates, delta=deltas), case)
    method.start(case)
    leaves = {group: value[None].clone().requires_grad_() for group, value in case.initial.items()}
    case.goal.advantage(case.target.logits(case.renderer.render(leaves))).sum().backward()
    seen, true = [], case.renderer.render

    def render(parameters: Mapping[str, Tensor]) -> Tensor:
        seen.append({group: value.abs().max() for group, value in parameters.items()})
        return true(parameters)

    case.renderer.render = render  # type: ignore[method-assign]
    method.advance(case, case.view(method.perturbation), 0)
    for group, delta in deltas.items():
        assert float(max(one[group] for one in seen)) == pytest.approx(delta, rel=1e-4)
        wanted = -rates[group] * leaves[group].grad[0].sign()  # type: ignore[index]
        torch.testing.assert_close(method.perturbation[group].double(), wanted, rtol=1e-4, atol=1e-7)


class Odd(CurvedRenderer):
    """Its image's change is an odd function of the parameters, which have no bounds: 0.4 sin(15 A x)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.weights = {group: 5 * weight for group, weight in self.weights.items()}
        self.base = 0.0 * self.base

    def bounds(self) -> dict[str, tuple[Tensor, Tensor]]:
        return FreeRenderer.bounds(self)  # type: ignore[arg-type]


def test_half_steps_are_measured_away_from_the_start() -> None:
    """Where the objective is λ‖ΔY‖² alone, both sides of a difference at the start are equal, whatever the half-step.
    Ten learning rates from it they are not, and a half-step chosen there is small enough for the curvature.
    """
    case = problem(Odd(), LinearTarget(scale=0.0), weight=30.0)
    rate = 2e-3
    found = ZooMethod(settings(delta="measured", learning_rate=rate), case).start(case)["delta"]
    at = 10 * rate * torch.tensor([1.0, -1, 1, 1, -1, 1, -1, -1, 1], dtype=torch.float64)
    every = torch.arange(9)
    truth = autograd(case, at)

    def error(step: float) -> float:
        steps = torch.full((9,), step, dtype=torch.float64)
        return float((estimate(case, at, every, steps, 0.0).gradients - truth).norm() / truth.norm())

    assert error(CANDIDATES[0]) > 0.1  # the largest, which is chosen where nothing changes
    for step in found.values():  # type: ignore[attr-defined]
        assert error(step) < 0.01
