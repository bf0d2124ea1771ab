"""Shapley values against the definition: the mean over all orders of the players, in exact fractions."""

from fractions import Fraction
from itertools import permutations

import pytest
import torch

from scene_attack.analysis import attribution

Game = list[Fraction]
"""v(S) for every set S, as the bits of its index say."""


def random_game(n: int, seed: int) -> Game:
    random = torch.Generator().manual_seed(seed)
    return [Fraction(int(v), 64) for v in torch.randint(-640, 640, (2**n,), generator=random)]


def by_orders(game: Game, n: int) -> list[Fraction]:
    """Each player's mean contribution when the players come one after another, over all n! orders."""
    values = [Fraction(0)] * n
    orders = list(permutations(range(n)))
    for order in orders:
        here = 0
        for player in order:
            values[player] += (game[here | 1 << player] - game[here]) / len(orders)
            here |= 1 << player
    return values


def pair_by_orders(game: Game, n: int, i: int, j: int) -> Fraction:
    """The mean of what the pair adds beyond its members, over all orders of the others and the pair as one player."""
    mean, orders = Fraction(0), list(permutations([k for k in range(n) if k not in (i, j)] + [-1]))
    for order in orders:
        before = sum(1 << k for k in order[: order.index(-1)])
        both = game[before | 1 << i | 1 << j] - game[before | 1 << i] - game[before | 1 << j] + game[before]
        mean += both / len(orders)
    return mean


def as_table(*games: Game) -> torch.Tensor:
    return torch.tensor([[float(v) for v in values] for values in zip(*games, strict=True)], dtype=torch.float64)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_values_and_interactions_are_means_over_all_orders(n: int) -> None:
    games = [random_game(n, seed) for seed in (1, 2)]
    values, interactions = attribution.exact(as_table(*games))
    for q, game in enumerate(games):
        assert values[:, q].tolist() == pytest.approx([float(v) for v in by_orders(game, n)], abs=1e-12)
        for i in range(n):
            assert interactions[i, i, q] == 0
            for j in range(i):
                expected = float(pair_by_orders(game, n, i, j))
                assert float(interactions[i, j, q]) == pytest.approx(expected, abs=1e-12)
                assert interactions[j, i, q] == interactions[i, j, q]
        assert float(values[:, q].sum()) == pytest.approx(float(game[-1] - game[0]), abs=1e-11)


def test_twelve_players_sum_to_the_effect() -> None:
    table = 10 * torch.randn(2**12, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    values, _ = attribution.exact(table)
    assert values.sum(dim=0).tolist() == pytest.approx((table[-1] - table[0]).tolist(), abs=1e-9)


def test_what_was_built_in_is_what_is_found() -> None:
    """v(S) = Σ aᵢ + Σ bᵢⱼ over the players and pairs in S: the value of i is aᵢ + ½ Σⱼ bᵢⱼ, the interaction bᵢⱼ."""
    alone, pairs = [0.5, -2.0, 0.25, 4.0], {(0, 1): 3.0, (1, 3): -0.5}
    table = torch.zeros(16, 1, dtype=torch.float64)
    for chosen in range(16):
        has = [bool(chosen >> i & 1) for i in range(4)]
        table[chosen] = 7.0 + sum(a for a, there in zip(alone, has, strict=True) if there)
        table[chosen] += sum(b for (i, j), b in pairs.items() if has[i] and has[j])
    values, interactions = attribution.exact(table)
    assert values[:, 0].tolist() == pytest.approx([0.5 + 1.5, -2 + 1.5 - 0.25, 0.25, 4 - 0.25], abs=1e-13)
    expected = torch.zeros(4, 4, dtype=torch.float64)
    for (i, j), b in pairs.items():
        expected[i, j] = expected[j, i] = b
    assert torch.allclose(interactions[:, :, 0], expected, atol=1e-13, rtol=0)


def test_no_player_at_all() -> None:
    values, interactions = attribution.exact(torch.tensor([[3.0, 4.0]], dtype=torch.float64))
    assert values.shape == (0, 2)
    assert interactions.shape == (0, 0, 2)


def test_a_table_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="3 values"):
        attribution.exact(torch.zeros(3, 1, dtype=torch.float64))


def test_sampled_values_are_as_far_off_as_their_standard_errors_say() -> None:
    """z-scores of 40 independent estimates of 5 values: their mean square is 1 up to what 200 values allow."""
    n = 5
    table = as_table(random_game(n, 4))
    exact, _ = attribution.exact(table)
    squares = []
    for seed in range(40):
        values, errors = attribution.sampled(lambda s: table[s], n, 200, torch.Generator().manual_seed(seed))
        assert float(values.sum()) == pytest.approx(float(table[-1] - table[0]), abs=1e-9)
        squares.append(((values - exact) / errors).square())
    # The values of one estimate are dependent; 40 estimates of mean square 1 have a standard error below 0.25.
    assert 0.5 < float(torch.stack(squares).mean()) < 1.5


def test_the_standard_error_is_that_of_the_mean_over_orders() -> None:
    table = as_table(random_game(4, 5))
    values, errors = attribution.sampled(lambda s: table[s], 4, 7, torch.Generator().manual_seed(0))
    random, gains = torch.Generator().manual_seed(0), []
    for _ in range(7):
        here, gain = 0, torch.zeros(4, dtype=torch.float64)
        for player in torch.randperm(4, generator=random).tolist():
            gain[player] = table[here | 1 << player, 0] - table[here, 0]
            here |= 1 << player
        gains.append(gain)
    found = torch.stack(gains)
    assert torch.allclose(values[:, 0], found.mean(dim=0), atol=1e-12)
    assert torch.allclose(errors[:, 0], found.std(dim=0) / 7**0.5, atol=1e-12)


def test_an_additive_game_has_no_standard_error() -> None:
    values, errors = attribution.sampled(
        lambda s: torch.tensor([float(s)], dtype=torch.float64), 6, 3, torch.Generator().manual_seed(0)
    )
    assert values[:, 0].tolist() == [1, 2, 4, 8, 16, 32]
    assert errors.abs().max() == 0


def test_no_set_is_asked_for_twice_and_one_order_is_too_few() -> None:
    asked: list[int] = []

    def value(chosen: int) -> torch.Tensor:
        asked.append(chosen)
        return torch.zeros(1, dtype=torch.float64)

    attribution.sampled(value, 3, 50, torch.Generator().manual_seed(0))
    assert sorted(asked) == list(range(8))
    with pytest.raises(ValueError, match="two orders"):
        attribution.sampled(value, 3, 1, torch.Generator().manual_seed(0))
