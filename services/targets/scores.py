"""Computes probabilities, log-odds and margins so that a confident network's gradient does not vanish."""

import torch
from torch import Tensor


def probability(logits: Tensor, label: int) -> Tensor:
    """Returns the softmax probability of `label`, float64 [B]; in float32 it would round to 1 at a margin of 20."""
    return torch.softmax(logits.double(), dim=-1)[..., label]


def _others(logits: Tensor, label: int) -> Tensor:
    """Returns the scores with −inf for `label`, which excludes it from logsumexp and from maxima."""
    return logits.index_fill(-1, torch.tensor([label], device=logits.device), -torch.inf)


def _wide(logits: Tensor) -> Tensor:
    """Returns the scores in float32 or wider: in bfloat16 a sum of a thousand exponentials has two digits."""
    return logits.to(torch.promote_types(logits.dtype, torch.float32))


def log_odds(logits: Tensor, label: int) -> Tensor:
    """Returns z_label − logsumexp of the other scores, [B].

    Its gradient has the direction of the probability's gradient and does not saturate. For a network with a single
    class it is +inf.
    """
    logits = _wide(logits)
    return logits[..., label] - torch.logsumexp(_others(logits, label), dim=-1)


def advantage(logits: Tensor, label: int) -> Tensor:
    """Returns log p_label − max over other labels of log p, [B]; negative if another label wins (paper, curves)."""
    logits = _wide(logits)
    return logits[..., label] - _others(logits, label).amax(dim=-1)
