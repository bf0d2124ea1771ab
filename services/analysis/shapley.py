"""Shapley values and pairwise interactions: how an effect is shared out among the changes that cause it together.

The changes are the *players* of a game, numbered 0 to n − 1. The game gives a value v(S) to every set S of players that
takes part; a set is an integer whose bit i says whether player i is in it. The *effect* is v(all) − v(none).
"""

from collections.abc import Callable
from functools import cache
from math import comb, sqrt

import torch
from torch import Tensor

Value = Callable[[int], Tensor]
"""The values of a set of players, float64 [q]: q quantities of which each is a game of its own."""


def exact(table: Tensor) -> tuple[Tensor, Tensor]:
    """Shapley values [n, q] and interactions [n, n, q] of games given by all values, float64 [2^n, q].

    A player's Shapley value is its mean contribution v(S ∪ i) − v(S) over all orders in which the players may come in
    (Shapley 1953); the values of all players sum to the effect. The interaction of i and j is the mean of
    v(S ∪ ij) − v(S ∪ i) − v(S ∪ j) + v(S) over the orders of the others and the pair (Grabisch and Roubens 1999): 0
    if their contributions add up, below 0 if either does what the other does. It is 0 on the diagonal.
    """
    n = table.shape[0].bit_length() - 1
    if table.shape[0] != 2**n:
        raise ValueError(f"a table of {table.shape[0]} values is not one of all sets of some players")
    sets = torch.arange(2**n)
    sizes = torch.tensor([chosen.bit_count() for chosen in range(2**n)])
    values = torch.zeros(n, table.shape[1], dtype=table.dtype)
    interactions = torch.zeros(n, n, table.shape[1], dtype=table.dtype)
    for i in range(n):
        without = sets[(sets >> i) & 1 == 0]
        gain = table[without | 1 << i] - table[without]
        values[i] = (_weights(n, sizes[without])[:, None] * gain).sum(dim=0)
        for j in range(i):
            neither = without[(without >> j) & 1 == 0]
            both = table[neither | 1 << i | 1 << j] + table[neither] - table[neither | 1 << i] - table[neither | 1 << j]
            interactions[i, j] = interactions[j, i] = (_weights(n - 1, sizes[neither])[:, None] * both).sum(dim=0)
    return values, interactions


def _weights(n: int, sizes: Tensor) -> Tensor:
    """The share of the orders of n players in which exactly a given set, of that size, comes before a given player."""
    by_size = torch.tensor([1 / (n * comb(n - 1, size)) for size in range(n)], dtype=torch.float64)
    return by_size[sizes]


def sampled(value: Value, n: int, orders: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Estimates of the Shapley values of n players and their standard errors, both [n, q], from random orders.

    Every order is one unbiased estimate of all values, which sum to the effect (Castro, Gómez and Tejada 2009). It asks
    for at most n − 1 values beside those of none and all. Raises ValueError for fewer than two orders.
    """
    if orders < 2:
        raise ValueError(f"a standard error needs two orders or more, not {orders}")
    known = cache(value)
    total = squares = torch.zeros_like(known(0)).expand(n, -1)
    for number in range(1, orders + 1):
        gain = torch.empty_like(total)
        players = 0
        for player in torch.randperm(n, generator=generator).tolist():
            gain[player] = known(players | 1 << player) - known(players)
            players |= 1 << player
        # Welford's update: no difference of large sums
        off = gain - total
        total = total + off / number
        squares = squares + off * (gain - total)
    return total, (squares / (orders - 1)).sqrt() / sqrt(orders)
