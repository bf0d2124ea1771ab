"""Attribution on a renderer and a network about which everything is known."""

from dataclasses import dataclass
from math import log

import pytest
import torch
from torch import Tensor

from scene_attack.analysis.attribution import moved_parts, of_coordinates, of_subsets
from scene_attack.analysis.records import Attribution, CoordinatesRequest
from scene_attack.analysis.subsets import scored, subsets
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.protocol import Parameters
from tests.unit.attacks.small import LinearRenderer, problem


class Pixels(LinearRenderer):
    """Pixel i has the grey value of coordinate i, in 255ths, so that rounding changes nothing; six coordinates."""

    size = (3, 3)

    def render(self, parameters: dict[str, Tensor]) -> Tensor:  # type: ignore[override]
        values = torch.cat([parameters[g].flatten(1) for g in ("a", "b")], dim=1)
        return (values / 255)[:, :, None].expand(-1, 9, 3).reshape(-1, 3, 3, 3)

    def names(self, group: str) -> list[str] | None:  # type: ignore[override]
        return [f"object 0 a {i}" for i in range(6)] if group == "a" else None


@dataclass
class Built:
    """A network of two labels with log-odds offset + Σ wᵢ xᵢ + Σ bᵢⱼ xᵢ xⱼ of the pixels' grey values x in 255ths."""

    alone: list[float]
    pairs: dict[tuple[int, int], float]
    offset: float = 0.0

    name = "built"
    labels = ("yes", "no")
    input_size = (3, 3)
    differentiable = True
    weights_sha256 = "0" * 64
    backend = "built"

    def logits(self, images: Tensor) -> Tensor:
        x = (images[..., 0].double() * 255).round().flatten(1)
        odds = self.offset + x @ torch.tensor(self.alone, dtype=torch.float64)
        for (i, j), b in self.pairs.items():
            odds = odds + b * x[:, i] * x[:, j]
        return torch.stack([odds, torch.zeros_like(odds)], dim=-1)


ALONE = [0.5, -0.25, 1.0, 0.0, 0.125, -1.0, 0.75, 0.25, -0.5]
PERTURBATION = {
    "a": torch.tensor([[1.0, 2.0, 0.0], [3.0, 1.0, 1.0]], dtype=torch.float64),
    "b": torch.tensor([2.0, 1.0, 0.0], dtype=torch.float64),
}


def both(target: Built, images: int = 4096, seed: int = 0) -> tuple[Attribution, Attribution]:
    """The attributions to groups and to coordinates."""
    verifier, goal = Verifier(Pixels(), target), ResolvedGoal((0,), None)
    ends = scored(verifier, {}), scored(verifier, PERTURBATION)
    rows = subsets(verifier, goal, PERTURBATION, *ends)
    queries = verifier.counts.queries
    ticks: list[tuple[int, int]] = []
    request = CoordinatesRequest(images=images)
    coordinates = of_coordinates(
        verifier, goal, PERTURBATION, *ends, request, seed=seed, tick=lambda *tick: ticks.append(tick)
    )
    assert coordinates.images == len(ticks) == verifier.counts.queries - queries
    assert [done for done, _ in ticks] == list(range(len(ticks)))
    assert all(done < of for done, of in ticks)
    return of_subsets(rows), coordinates


def test_an_additive_network_has_no_interactions() -> None:
    groups, coordinates = both(Built(ALONE, {}))
    assert groups.parts == ["a", "b"]
    assert groups.log_odds.shapley == pytest.approx([0.5 - 0.5 + 0.125 - 1.0, 1.5 + 0.25], abs=1e-9)
    assert coordinates.parts == [*(f"object 0 a {i}" for i in (0, 1, 3, 4, 5)), "b"]
    assert coordinates.log_odds.shapley == pytest.approx([0.5, -0.5, 0.0, 0.125, -1.0, 1.75], abs=1e-9)
    for found in (groups, coordinates):
        assert found.log_odds.interactions is not None
        assert torch.tensor(found.log_odds.interactions).abs().max() < 1e-9
        assert found.probability.interactions is not None
        assert torch.tensor(found.probability.interactions).abs().max() > 1e-3, "probabilities are not additive"


def test_by_object_a_part_is_what_an_object_has_of_a_group() -> None:
    verifier, goal = Verifier(Pixels(), Built(ALONE, {(0, 6): 0.1, (3, 7): -0.2})), ResolvedGoal((0,), None)
    ends = scored(verifier, {}), scored(verifier, PERTURBATION)
    groups = of_subsets(subsets(verifier, goal, PERTURBATION, *ends))
    found = of_coordinates(
        verifier, goal, PERTURBATION, *ends, CoordinatesRequest(by="object"), seed=0, tick=lambda *_: None
    )
    assert found.parts == ["object 0 a", "b"]  # all coordinates of "a" are one object's
    assert found.log_odds == groups.log_odds
    two = torch.zeros(2, 3)
    two[0, 1] = two[1, 0] = two[1, 2] = 1.0
    labels = [f"object {k} color {channel}" for k in (0, 1) for channel in ("red", "green", "blue")]
    parts = moved_parts({"color": two}, lambda _: labels, "object")
    assert [(part.name, part.indices) for part in parts] == [("object 0 color", (1,)), ("object 1 color", (3, 5))]
    lamps = moved_parts({"illumination": torch.ones(3)}, lambda _: ["ambient", "point 0 energy", "point 0 x"], "object")
    assert [(part.name, part.indices) for part in lamps] == [
        ("illumination: ambient", (0,)),
        ("illumination: point 0", (1, 2)),
    ]


def test_a_built_interaction_is_found_as_it_was_built() -> None:
    # pixels 0 and 1 are of group a, pixel 6 is the first coordinate of b; each product is of the values 1, 2 and 2
    groups, coordinates = both(Built(ALONE, {(0, 1): 0.5, (1, 6): -0.75}))
    assert groups.log_odds.interactions is not None
    assert torch.tensor(groups.log_odds.interactions).tolist() == [
        pytest.approx([0, -3.0], abs=1e-6),
        pytest.approx([-3.0, 0], abs=1e-6),
    ]
    found = torch.tensor(coordinates.log_odds.interactions)
    expected = torch.zeros(6, 6)
    expected[0, 1] = expected[1, 0] = 0.5 * 1 * 2
    expected[1, 5] = expected[5, 1] = -0.75 * 2 * 2
    assert torch.allclose(found, expected, atol=1e-6)


def test_values_sum_to_the_effect() -> None:
    for found in both(Built(ALONE, {(0, 6): 0.1, (3, 7): -0.2})):
        for shares in (found.log_odds, found.probability):
            assert sum(shares.shapley) == pytest.approx(shares.effect, abs=1e-9)
    odds = sum(w * x for w, x in zip(ALONE, [1, 2, 0, 3, 1, 1, 2, 1, 0], strict=True)) + 0.2 - 0.6
    assert found.log_odds.effect == pytest.approx(odds, abs=1e-6)
    assert log((0.5 + found.probability.effect) / (0.5 - found.probability.effect)) == pytest.approx(odds, abs=1e-6)


def test_sampled_within_the_budget_and_the_same_for_the_same_seed() -> None:
    target = Built(ALONE, {(0, 1): 0.5, (1, 6): -0.75})
    _, exact = both(target)
    _, sampled = both(target, images=40)
    assert (exact.method, sampled.method) == ("exact", "sampled")
    assert exact.images == 2**6 - 2
    assert sampled.images <= 40
    assert sampled.orders == 8
    assert sampled.log_odds.interactions is None
    assert sampled.log_odds.standard_error is not None
    assert sum(sampled.log_odds.shapley) == pytest.approx(exact.log_odds.effect, abs=1e-9)
    for value, error, truth in zip(
        sampled.log_odds.shapley, sampled.log_odds.standard_error, exact.log_odds.shapley, strict=True
    ):
        assert abs(value - truth) <= 5 * error + 1e-9
    assert both(target, images=40)[1] == sampled
    assert both(target, images=40, seed=1)[1] != sampled


def test_a_targeted_goal_is_attributed_by_the_label_to_reach() -> None:
    verifier = Verifier(Pixels(), Built(ALONE, {}))
    rows = []
    for goal in (ResolvedGoal((0,), None), ResolvedGoal((), 1)):
        ends = scored(verifier, {}), scored(verifier, PERTURBATION)
        rows.append(of_subsets(subsets(verifier, goal, PERTURBATION, *ends)).log_odds.shapley)
    assert rows[0] == pytest.approx([-v for v in rows[1]], abs=1e-9)


def test_what_does_not_move_is_no_part() -> None:
    still: Parameters = {"a": torch.zeros(2, 3), "b": torch.zeros(3)}
    assert moved_parts(still, Pixels().names) == []
    case = problem()
    verifier = Verifier(case.renderer, case.target)
    end = scored(verifier, {})
    found = of_coordinates(verifier, case.goal, still, end, end, CoordinatesRequest(), seed=0, tick=lambda *_: None)
    assert found.parts == found.log_odds.shapley == []
    assert found.log_odds.effect == 0
