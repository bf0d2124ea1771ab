"""The box of a perturbation, random starts in it, and backtracking to U."""

from dataclasses import dataclass
from typing import Any

import pytest
import torch

from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.limits import BACKTRACK_MARGIN, P_MARGIN, SLACK, Limits, pulled_back
from scene_attack.attacks.problem import random_start
from scene_attack.errors import InvalidRequest
from tests.unit.attacks.small import Ahead, FreeRenderer, LinearRenderer, attack, problem

INITIAL = {"a": torch.tensor([0.5, 0.9], dtype=torch.float64), "b": torch.tensor([0.0], dtype=torch.float64)}
FREE = (torch.tensor(-torch.inf), torch.tensor(torch.inf))
PHYSICAL = {"a": (torch.tensor(0.0), torch.tensor(1.0)), "b": FREE}


@dataclass
class Values:
    """The values of a renderer and their bounds."""

    values: dict[str, torch.Tensor]
    physical: dict[str, tuple[torch.Tensor, torch.Tensor]]

    def initial(self) -> dict[str, torch.Tensor]:
        return self.values

    def bounds(self) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
        return self.physical


def limits(**given: Any) -> Limits:
    return Limits.of(Values(INITIAL, PHYSICAL), ["a", "b"], **given)  # type: ignore[arg-type]


def test_the_box_is_what_all_limits_allow() -> None:
    physical = limits()
    assert [float(side[2]) for side in (physical.low, physical.high)] == [-torch.inf, torch.inf]  # b has no limit
    both = limits(bounds={"a": (0.45, 1.0), "b": (-1.0, 3.0)}, epsilon={"a": 0.3, "b": 2.0})
    torch.testing.assert_close(both.low, torch.tensor([-0.05, -0.3, -1.0], dtype=torch.float64))
    torch.testing.assert_close(both.high, torch.tensor([0.3, 0.1, 2.0], dtype=torch.float64))


def test_bounds_that_exclude_the_start_are_refused_by_the_field() -> None:
    with pytest.raises(InvalidRequest, match=r"exclude the start: .* value of 0.9, not within 0.2 to 0.8") as error:
        limits(bounds={"a": (0.2, 0.8)})
    assert error.value.field == "attack.bounds.a"


@pytest.mark.parametrize(
    ("field", "given", "within"),
    [
        ("attack.bounds.a", {"bounds": {"a": (0.2, 2.0)}}, "0.2 to 2 goes beyond what can be drawn, 0 to 1"),
        ("attack.bounds.a", {"bounds": {"a": (-0.5, 1.0)}}, "-0.5 to 1 goes beyond what can be drawn, 0 to 1"),
        ("attack.epsilon.c", {"epsilon": {"c": 21.0}}, "21 goes beyond what can be drawn, a change of 20"),
    ],
)
def test_a_range_beyond_what_can_be_drawn_is_refused(field: str, given: dict[str, Any], within: str) -> None:
    heights = {"c": (torch.tensor(-20.0), torch.tensor(20.0))}
    values = Values(INITIAL | {"c": torch.zeros(3)}, PHYSICAL | heights)
    with pytest.raises(InvalidRequest, match=within) as error:
        Limits.of(values, ["a", "b", "c"], **given)  # type: ignore[arg-type]
    assert error.value.field == field
    ends = {"bounds": {"a": (0.0, 1.0), "c": (-20.0, 20.0)}, "epsilon": {"a": 3.0, "b": 1e9, "c": 20.0}}
    assert Limits.of(values, ["a", "b", "c"], **ends).high.isfinite().all()  # type: ignore[arg-type]


def test_a_random_start_fills_the_box_and_is_the_seeds() -> None:
    initial = {"a": torch.zeros(2000, dtype=torch.float64)}
    bounds = {"a": (torch.tensor(-0.1), torch.tensor(0.3))}
    filled = Limits.of(Values(initial, bounds), ["a"])  # type: ignore[arg-type]
    start = random_start(filled, seed=3, restart=1)
    assert -0.1 <= float(start.min()) < -0.09
    assert 0.29 < float(start.max()) <= 0.3
    assert float(start.mean()) == pytest.approx(0.1, abs=4 * 0.4 / (12 * 2000) ** 0.5)  # four standard errors
    assert torch.equal(start, random_start(filled, seed=3, restart=1))
    assert not torch.equal(start, random_start(filled, seed=3, restart=2))


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_backtracking_comes_close_to_the_limit_in_few_tries(power: float) -> None:
    """Reach as a power of the length: of silhouettes 1/2, of colours 1. Rows within the limit stay as they are."""
    vectors = torch.tensor([[3.0, 4.0], [0.3, 0.4], [0.0, 0.0], [300.0, 0.0]], dtype=torch.float64)
    tried: list[float] = []

    def reach(vector: torch.Tensor) -> float:
        tried.append(float(vector.norm()) ** power)
        return tried[-1]

    found = pulled_back(reach, vectors)
    assert torch.equal(found[1:3], vectors[1:3])
    for row in (0, 3):
        assert 1 - SLACK <= float(found[row].norm()) ** power <= 1
        assert torch.allclose(found[row] / found[row].norm(), vectors[row] / vectors[row].norm())
    assert len(tried) <= 4 + 2 * 2


@pytest.mark.parametrize(
    "reach",
    [
        lambda v: 1.5 * float(v.norm() > 0.3),  # a jump: nothing is between 0 and 1.5
        lambda v: float(v.norm()) + 0.4 * float(torch.sin(40 * v.norm())),  # it falls here and there
        lambda v: 2.0 * float(v.norm() > 0),
    ],
)
def test_what_backtracking_returns_is_within_however_the_reach_grows(reach: Any) -> None:
    vectors = torch.tensor([[3.0, 4.0], [0.0, 1.0]], dtype=torch.float64)
    found = pulled_back(reach, vectors)
    assert all(reach(vector) <= 1 for vector in found)


def test_an_attack_that_backtracks_keeps_image_and_scene_one() -> None:
    """The stored scene itself is within U; by truncation only the loop's image is."""
    limit = 12 / 255
    rates = FGSM.model_construct(learning_rate={"a": 0.05, "b": 0.05}, momentum=0.9, weight_decay=0.0)
    hard = Ahead(FreeRenderer())
    beyond = {}
    for name in ("truncation", "backtrack"):
        case = problem(FreeRenderer(), hard, **{name: limit})
        found = attack(case, rates, steps=12)
        assert found.best is not None
        moved = case.layout.unflatten((case.initial + found.best.delta)[None])
        beyond[name] = float((case.renderer.render(moved) - case.original).abs().max()) - limit
        assert found.trace[-1].truncated > 0 if name == "truncation" else not found.ever_truncated.any()
    assert beyond["truncation"] > limit
    assert -2 * BACKTRACK_MARGIN - 0.1 * limit < beyond["backtrack"] <= -BACKTRACK_MARGIN + 1e-6


def test_an_attack_that_backtracks_keeps_p_within_its_limit() -> None:
    """The stored scene's p, computed here on its own, comes close to the limit and stays within it."""
    limit = 0.03
    rates = FGSM.model_construct(learning_rate={"a": 0.05, "b": 0.05}, momentum=0.9, weight_decay=0.0)
    hard = Ahead(FreeRenderer())
    case = problem(FreeRenderer(), hard, perceptibility=limit)
    found = attack(case, rates, steps=12)
    assert found.best is not None
    moved = case.layout.unflatten((case.initial + found.best.delta)[None])
    change = (case.renderer.render(moved) - case.original)[0]
    p = (sum(float(value) ** 2 for value in change.flatten()) / (change.shape[0] * change.shape[1])) ** 0.5
    assert 0.9 * limit < p <= (1 - P_MARGIN) * limit + 1e-9
    assert max(row.perceptibility for row in found.trace) <= (1 - P_MARGIN) * limit + 1e-9


def test_both_limits_of_backtracking_hold() -> None:
    original = torch.full((1, 2, 2, 3), 0.5)
    image = original.clone()
    image[0, 0, 0, 0] += 0.1  # p is 0.05

    def reached(**given: float) -> float:
        return limits(**given).reached(image, original)

    assert reached(backtrack=0.11, perceptibility=0.06) < 1 < reached(backtrack=0.09, perceptibility=0.06)
    assert reached(backtrack=0.11, perceptibility=0.04) == pytest.approx(0.05 / (0.04 * (1 - P_MARGIN)))
    assert reached() == 0


def test_every_method_stays_within_epsilon() -> None:
    case = problem(LinearRenderer(), Ahead(LinearRenderer()), epsilon={"a": 0.015, "b": 0.01})
    rates = FGSM.model_construct(learning_rate={"a": 0.01, "b": 0.01}, momentum=0.0, weight_decay=0.0)
    found = attack(case, rates, steps=4)
    assert float(found.stored["a"].abs().max()) == pytest.approx(0.015)
    assert float(found.stored["b"].abs().max()) <= 0.01


def test_backtracking_keeps_half_a_bit_from_the_limit() -> None:
    """The plan's error, at most a quarter of a bit by default, and the rounding may take the exact image that far."""
    original = torch.full((1, 2, 2, 3), 0.5, dtype=torch.float64)
    limit = 18 / 255
    within, beyond = (limits(backtrack=limit).reached(original + bits / 255, original) for bits in (17.45, 17.55))
    assert within < 1 < beyond
