"""Computes probabilities, log-odds and margins so that a confident network's gradient does not vanish.

All functions take scores [..., K] and return [...]. `labels` is the index of one label or those of a set of labels,
which then counts as one answer.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

Labels = int | Sequence[int]


def probability(logits: Tensor, labels: Labels) -> Tensor:
    """Returns the softmax probability of the labels together, float64; in float32 a margin of 20 would round to 1."""
    return torch.softmax(logits.double(), dim=-1).index_select(-1, _index(logits, labels)).sum(dim=-1)


def _index(logits: Tensor, labels: Labels) -> Tensor:
    return torch.tensor([labels] if isinstance(labels, int) else list(labels), device=logits.device)


def _others(logits: Tensor, labels: Labels) -> Tensor:
    """Returns the scores with −inf for the labels, which excludes them from logsumexp and from maxima."""
    return logits.index_fill(-1, _index(logits, labels), -torch.inf)


def _wide(logits: Tensor) -> Tensor:
    """Returns the scores in float32 or wider: in bfloat16 a sum of a thousand exponentials has two digits."""
    return logits.to(torch.promote_types(logits.dtype, torch.float32))


def log_odds(logits: Tensor, labels: Labels) -> Tensor:
    """Returns logsumexp of the labels' scores − logsumexp of the other scores.

    Its gradient has the direction of the probability's gradient and does not saturate. If there is no other label it is
    +inf.
    """
    logits = _wide(logits)
    inside = logits.index_select(-1, _index(logits, labels))
    return torch.logsumexp(inside, dim=-1) - torch.logsumexp(_others(logits, labels), dim=-1)


def advantage(logits: Tensor, labels: Labels) -> Tensor:
    """Returns the labels' largest log p − the others' largest log p; negative if another label wins (paper, curves)."""
    logits = _wide(logits)
    return logits.index_select(-1, _index(logits, labels)).amax(dim=-1) - _others(logits, labels).amax(dim=-1)


def log_odds_of_best_other(logits: Tensor, labels: Labels) -> Tensor:
    """Returns the log-odds of the most probable label that is not among `labels`."""
    logits = _wide(logits)
    best = _others(logits, labels).argmax(dim=-1, keepdim=True)
    rest = logits.scatter(-1, best, -torch.inf)
    return logits.gather(-1, best).squeeze(-1) - torch.logsumexp(rest, dim=-1)
