"""Probabilities, log-odds and margins, computed so that a confident network does not hide its gradient."""

import torch
from torch import Tensor


def probability(logits: Tensor, label: int) -> Tensor:
    """Softmax probability of `label`, [B], in float64: at a margin of 20 float32 has already lost it to 1."""
    return torch.softmax(logits.double(), dim=-1)[..., label]


def _others(logits: Tensor, label: int) -> Tensor:
    """The scores with −inf for `label`: neither a sum of exponentials nor a maximum sees it."""
    return logits.index_fill(-1, torch.tensor([label], device=logits.device), -torch.inf)


def _wide(logits: Tensor) -> Tensor:
    """In float32 at least: a sum of a thousand exponentials in bfloat16 has two digits."""
    return logits.to(torch.promote_types(logits.dtype, torch.float32))


def log_odds(logits: Tensor, label: int) -> Tensor:
    """z_label − logsumexp of the others, [B]. Same gradient direction as the probability's, and never saturated.

    For a one-class network there are no others and the log-odds are +inf.
    """
    logits = _wide(logits)
    return logits[..., label] - torch.logsumexp(_others(logits, label), dim=-1)


def advantage(logits: Tensor, label: int) -> Tensor:
    """log p_label − max over others of log p, [B]; negative once another label wins (paper, attack curves)."""
    logits = _wide(logits)
    return logits[..., label] - _others(logits, label).amax(dim=-1)
