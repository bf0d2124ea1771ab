"""Attribution of an attack's effect to the groups or the coordinates of its perturbation, by Shapley values.

The changes are the *players* of a game, numbered 0 to n − 1. The game gives a value v(S) to every set S of players that
takes part; a set is an integer whose bit i says whether player i is in it. The *effect* is v(all) − v(none): the change
of the log-odds, and of the probability, of the goal's label from the original image to that of the whole perturbation,
both rendered exactly and rounded to 8 bits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import comb, sqrt

import torch
from torch import Tensor

from scene_attack.analysis.images import answer, goal_log_odds
from scene_attack.analysis.records import Attribution, By, CoordinatesRequest, Shares, Subset
from scene_attack.analysis.subsets import ScoredImage
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import generator
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.protocol import Parameters

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


MOST_EXACT = 12
"""Largest number of coordinates whose Shapley values are computed from all their subsets, 4,096 of them."""


Tick = Callable[[int, int], None]
"""Called before each image of an analysis with the number of those done and the largest number there may be. It reports
progress, and may raise Cancelled."""


@dataclass(frozen=True)
class Part:
    """A player: some coordinates of a group, or all of a group whose coordinates have no names."""

    name: str
    group: str
    indices: tuple[int, ...] | None


def of_subsets(rows: Sequence[Subset]) -> Attribution:
    """The attribution to the groups, from the table of all their subsets; the last row is that of all groups."""
    groups = rows[-1].groups
    table = torch.zeros(len(rows), 2, dtype=torch.float64)
    for row in rows:
        at = sum(1 << groups.index(group) for group in row.groups)
        table[at] = torch.tensor([row.goal_log_odds, row.goal_probability], dtype=torch.float64)
    return _exact(groups, table, max(0, len(rows) - 2))


def moved_parts(
    perturbation: Parameters, names: Callable[[str], list[str] | None], by: By = "coordinate"
) -> list[Part]:
    """The parts of a perturbation that are not zero; `names` gives the labels of a group's coordinates, or None.

    By object, coordinates whose labels differ in the last word are one part: of "object 0 color red", "… green" and
    "… blue" it is "object 0 color".
    """
    parts = []
    for group, value in perturbation.items():
        moved = value.flatten().nonzero().flatten().tolist()
        labels = names(group)
        if labels is not None:
            whole: dict[str | int, list[int]] = {}
            for index in moved:
                whole.setdefault(_owner(labels[index]) if by == "object" else index, []).append(index)
            for key, indices in whole.items():
                name = key if isinstance(key, str) else labels[key]
                # most names say the group themselves: "object 0 rotation x"
                parts.append(Part(name if group in name else f"{group}: {name}", group, tuple(indices)))
        elif moved:
            parts.append(Part(group, group, None))
    return parts


def _owner(label: str) -> str:
    """A coordinate's label without its last word; a label of one word is its own."""
    return label.rpartition(" ")[0] or label


def of_coordinates(
    verifier: Verifier,
    goal: ResolvedGoal,
    perturbation: Parameters,
    original: ScoredImage,
    attacked: ScoredImage,
    request: CoordinatesRequest,
    *,
    seed: int,
    tick: Tick,
) -> Attribution:
    """The attribution to single coordinates, or to all of a group that belong to an object or a light; a group whose
    coordinates have no names (pixels, texels) is one part.

    A coordinate that the perturbation does not move contributes nothing and is left out. Values are exact for up to
    `MOST_EXACT` parts, if their subsets are no more than `request.images`, and else the mean over as many random
    orders as these allow, two at least.
    """
    parts = moved_parts(perturbation, verifier.renderer.exact().names, request.by)
    count, full = len(parts), 2 ** len(parts) - 1
    is_exact = count <= MOST_EXACT and 2**count <= request.images
    orders = max(2, request.images // max(1, count - 1))
    most = 2**count - 2 if is_exact else orders * (count - 1)
    asked = 0

    def value(chosen: int) -> Tensor:
        nonlocal asked
        if chosen in (0, full):
            logits = (original if chosen == 0 else attacked).logits
        else:
            tick(asked, most)
            asked += 1
            logits = verifier.logits(verifier.image(_only(perturbation, parts, chosen)))
        network_answer = answer(logits, verifier.target.labels, goal)
        return torch.tensor([goal_log_odds(logits, goal), network_answer.goal_probability], dtype=torch.float64)

    names = [part.name for part in parts]
    if is_exact:
        table = torch.stack([value(chosen) for chosen in range(2**count)])
        return _exact(names, table, asked)
    values, errors = sampled(value, count, orders, generator(seed, "attribution"))
    effect = value(full) - value(0)
    log_odds, probability = (
        Shares(effect=float(effect[k]), shapley=values[:, k].tolist(), standard_error=errors[:, k].tolist())
        for k in range(2)
    )
    return Attribution(
        parts=names, method="sampled", orders=orders, images=asked, log_odds=log_odds, probability=probability
    )


def _only(perturbation: Parameters, parts: Sequence[Part], chosen: int) -> Parameters:
    """The perturbation with the parts whose bit in `chosen` is set, and zeros elsewhere."""
    kept = {group: torch.zeros_like(value) for group, value in perturbation.items()}
    for number, part in enumerate(parts):
        if chosen >> number & 1:
            at = slice(None) if part.indices is None else list(part.indices)
            kept[part.group].view(-1)[at] = perturbation[part.group].reshape(-1)[at]
    return kept


def _exact(names: Sequence[str], table: Tensor, images: int) -> Attribution:
    """The attribution given by the values of all subsets, [2^n, 2]: log-odds and probability."""
    values, interactions = exact(table)
    log_odds, probability = (
        Shares(
            effect=float(table[-1, k] - table[0, k]),
            shapley=values[:, k].tolist(),
            interactions=interactions[:, :, k].tolist(),
        )
        for k in range(2)
    )
    return Attribution(parts=list(names), method="exact", images=images, log_odds=log_odds, probability=probability)
