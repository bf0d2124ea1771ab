from collections.abc import Mapping

import pytest
import torch
from torch import Tensor

from scene_attack.attacks.differences import CANDIDATES, estimate
from scene_attack.attacks.zoo import ZOO
from tests.unit.attacks.small import (
    CurvedRenderer,
    FreeRenderer,
    LinearRenderer,
    LinearTarget,
    attack,
    autograd,
    problem,
    stepped,
)


def settings(**changes: object) -> ZOO:
    values = {"coordinates": 128, "delta": 1e-4, "learning_rate": 2e-3, "steps": 10}
    return ZOO.model_construct(**(values | changes))  # type: ignore[arg-type]


def test_with_all_coordinates_it_is_adam_on_the_true_gradient() -> None:
    """torch.optim.Adam, fed by autograd, is the reference: nothing of the estimate or the update is shared."""
    case = problem(distance_weight=0.3)
    state = settings().init(case)
    leaf = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    adam = torch.optim.Adam([leaf], lr=2e-3)
    for step in range(5):
        images = case.renderer.render({"a": leaf[None], "b": state["delta"][None, 6:].double()})
        value = case.goal.advantage(case.target.logits(images)).sum()
        value = value + 0.3 * (images - case.original).square().sum()
        (leaf.grad,) = torch.autograd.grad(value, leaf)
        state = stepped(case, settings(), state, step)
        adam.step()
        moved = state["delta"][:6].double().reshape(2, 3)
        torch.testing.assert_close(moved, leaf.detach(), rtol=1e-4, atol=1e-7)


def test_only_chosen_coordinates_move_and_the_choice_is_the_seeds() -> None:
    moved = []
    for seed in (0, 0, 1):
        case = problem(seed=seed)
        zoo = settings(coordinates=3)
        state = stepped(case, zoo, zoo.init(case), 0)
        assert int((state["moves"] > 0).sum()) <= 3
        moved.append(state["delta"])
    assert torch.equal(moved[0], moved[1])
    assert not torch.equal(moved[0], moved[2])


def test_coordinates_below_the_noise_are_counted_and_left_alone() -> None:
    renderer = LinearRenderer()
    renderer.weights["b"] *= 0
    case = problem(renderer)
    run = attack(case, settings(), steps=1)
    assert run.trace[-1].below_noise == 3
    assert (run.state["moves"][6:] == 0).all()
    assert (run.state["delta"][6:] == 0).all()


def test_a_heavy_weight_keeps_the_image_closer() -> None:
    distances = []
    for weight in (0.0, 100.0):
        case = problem(distance_weight=weight)
        state = settings().init(case)
        for step in range(60):
            state = stepped(case, settings(), state, step)
        distances.append(float((case.render(state["delta"][None]) - case.original).norm()))
    assert distances[1] < 0.5 * distances[0]


def test_measured_steps_are_reported() -> None:
    case = problem()
    found = attack(case, settings(delta="measured"), steps=1).settings
    assert set(found) == {"delta", "noise", "skipped"}
    assert set(found["delta"]) == {"a", "b"}  # type: ignore[call-overload]


def test_every_step_draws_coordinates_of_its_own() -> None:
    case = problem()
    zoo = settings(coordinates=3)
    state = zoo.init(case)
    for step in range(20):
        before = state["moves"]
        state = stepped(case, zoo, state, step)
        assert int((state["moves"] - before).sum()) <= 3
    assert (state["moves"] > 0).all()  # of 9 coordinates; one that is drawn with 1/3 is missed 20 times with 3e-4
    assert len(state["moves"].unique()) > 1


def test_each_group_has_its_own_half_step_and_rate() -> None:
    """Adam's first step is the rate times the gradient's sign, whatever its length."""
    rates, deltas = {"a": 0.01, "b": 0.03}, {"a": 2e-3, "b": 5e-4}
    case = problem(FreeRenderer(), distance_weight=0.3)
    zoo = settings(learning_rate=rates, delta=deltas)
    state = zoo.init(case)
    leaves = {group: value[None].clone().requires_grad_() for group, value in case.renderer.initial().items()}
    case.goal.advantage(case.target.logits(case.renderer.render(leaves))).sum().backward()
    seen, true = [], case.renderer.render

    def render(parameters: Mapping[str, Tensor]) -> Tensor:
        seen.append({group: value.abs().max() for group, value in parameters.items()})
        return true(parameters)

    case.renderer.render = render  # type: ignore[method-assign]
    moved = case.layout.unflatten(stepped(case, zoo, state, 0)["delta"])
    for group, delta in deltas.items():
        assert float(max(one[group] for one in seen)) == pytest.approx(delta, rel=1e-4)
        wanted = -rates[group] * leaves[group].grad[0].sign()  # type: ignore[index]
        torch.testing.assert_close(moved[group].double(), wanted, rtol=1e-4, atol=1e-7)


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
    case = problem(Odd(), LinearTarget(scale=0.0), distance_weight=30.0)
    rate = 2e-3
    zoo = settings(delta="measured", learning_rate=rate)
    found = zoo.measured(case, zoo.init(case))["delta"]
    at = 10 * rate * torch.tensor([1.0, -1, 1, 1, -1, 1, -1, -1, 1], dtype=torch.float64)
    every = torch.arange(9)
    truth = autograd(case, at)

    def error(step: float) -> float:
        steps = torch.full((9,), step, dtype=torch.float64)
        return float((estimate(case, at, every, steps, 0.0).gradients - truth).norm() / truth.norm())

    assert error(CANDIDATES[0]) > 0.1  # the largest, which is chosen where nothing changes
    for step in found.values():  # type: ignore[attr-defined]
        assert error(step) < 0.01
