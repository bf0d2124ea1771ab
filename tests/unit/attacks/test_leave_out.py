"""Coordinates are left out of a search only if they were measured to do nothing that counts."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
import torch

from scene_attack.attacks.leave_out import SHARE, leave_out
from scene_attack.attacks.zoo import ZOO
from tests.unit.attacks.small import FreeRenderer, LinearTarget, attack, problem
from tests.unit.attacks.test_constraint import Ball


class Weak(FreeRenderer):
    """Coordinates 1 and 4 of group "a" do nothing, coordinate 2 a thousandth, the others what they do in the base."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.weights["a"][:, [1, 4]] = 0.0
        self.weights["a"][:, 2] *= 1e-3


CHANGE = {"a": 0.01, "b": 0.01}


def test_effects_are_those_of_the_linear_network() -> None:
    renderer, target = Weak(), LinearTarget()
    case = problem(renderer, target)
    found = leave_out(case, CHANGE)
    # the advantage of the first answer over the second is linear as long as the second stays the second
    logits = target.logits(renderer.render({g: v[None] for g, v in renderer.initial().items()}))[0]
    first, second = logits.topk(2).indices.tolist()
    gap = target.scale * (target.weights[:, first] - target.weights[:, second])
    expected = torch.cat([(renderer.weights[g].T @ gap).abs() * 0.01 for g in ("a", "b")])
    assert found.advantage == pytest.approx(float(logits[first] - logits[second]))
    assert torch.allclose(found.alone, expected, rtol=1e-6, atol=1e-9)


def test_only_what_does_nothing_that_counts_is_left_out() -> None:
    case = problem(Weak(), LinearTarget())
    found = leave_out(case, CHANGE)
    left = found.left_out.nonzero()[:, 0].tolist()
    assert {1, 4} <= set(left)
    assert float(found.alone[left].sum()) <= SHARE * found.advantage
    assert found.together <= SHARE * found.advantage
    others = [k for k in range(9) if k not in left]
    smallest = float(found.alone[others].min())
    assert float(found.alone[left].sum()) + smallest > SHARE * found.advantage


def test_an_attack_never_moves_what_is_left_out() -> None:
    renderer = Weak()
    whole = problem(renderer, LinearTarget(scale=0.1), constraint=Ball(0.5))
    found = leave_out(whole, CHANGE)
    case = found.without
    settings = ZOO.model_construct(
        coordinates=9, delta=1e-3, learning_rate={"a": 0.05, "b": 0.01}, weight=0.0, steps=4, method="zoo"
    )
    moved = case.layout.flatten(attack(case, settings).stored) != 0
    assert not bool((moved & found.left_out).any())
    assert not bool(moved[5])  # the inner constraint's
    assert bool(moved.any())


def test_an_advantage_that_is_gone_leaves_nothing_out_that_does_anything() -> None:
    case = problem(FreeRenderer(), LinearTarget())
    goal = type(case.goal)((), int(1 - case.goal.leave[0] % 2))  # to reach: no advantage of its own kind
    found = leave_out(replace(case, goal=goal), {"a": 0.01})
    assert not bool(found.left_out[6:].any())  # group "b" was not measured
    assert float(found.alone[found.left_out].sum()) <= SHARE * max(found.advantage, 0.0)


class OneSided(FreeRenderer):
    """Group "b" is at a bound: 1 its largest value if `side` is 1, its smallest if it is -1."""

    side = 1

    def bounds(self) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
        free, zero = torch.tensor(torch.inf), torch.tensor(0.0)
        return {"a": (-free, free), "b": (-free, zero) if self.side > 0 else (zero, free)}


@pytest.mark.parametrize("side", [1, -1])
def test_the_effect_is_that_of_the_larger_of_both_sides(side: int) -> None:
    renderer = OneSided()
    renderer.side = side
    bounded, free = (leave_out(problem(one, LinearTarget()), CHANGE).alone for one in (renderer, FreeRenderer()))
    assert torch.allclose(bounded, free, rtol=1e-6)
    assert bool((bounded > 0).all())


class Product(FreeRenderer):
    """The first two coordinates of group "b" do nothing alone, and much together."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.weights["b"][:, :2] = 0.0

    def render(self, parameters: Mapping[str, torch.Tensor]) -> torch.Tensor:
        image = super().render(parameters)
        return image if "b" not in parameters else image + 1e3 * parameters["b"][:, :2].prod(dim=1)[:, None, None, None]


def test_what_counts_together_is_not_left_out_together() -> None:
    found = leave_out(problem(Product(), LinearTarget()), CHANGE)
    assert found.alone[6:8].tolist() == [0, 0]
    assert not bool(found.left_out[6:8].all())
    assert found.together <= SHARE * found.advantage


def test_effects_are_those_of_moves_that_the_constraint_allows() -> None:
    renderer, target = FreeRenderer(), LinearTarget()
    free = leave_out(problem(renderer, target), CHANGE).alone
    held = leave_out(problem(renderer, target, constraint=Ball(0.002)), CHANGE).alone
    assert torch.allclose(held[:5], 0.2 * free[:5], rtol=1e-6)
    assert held[5] == 0
    assert torch.allclose(held[6:], free[6:], rtol=1e-6)
