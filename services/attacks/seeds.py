"""Random numbers of an attack that may be resumed: each step has its own generator, derived from the job's seed."""

import hashlib

import torch
from torch import Tensor


def generator(seed: int, *words: str | int) -> torch.Generator:
    """A CPU generator that depends on the seed and on `words` alone, which name the purpose and the step."""
    return torch.Generator().manual_seed(derived(seed, *words))


def derived(seed: int, *words: str | int) -> int:
    """A seed of 63 bits that depends on the seed and on `words` alone."""
    text = "/".join([str(seed), *map(str, words)])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") % 2**63


def draw(pool: Tensor, count: int, seed: int, *words: str | int) -> Tensor:
    """Draws `count` distinct elements of `pool` [n], in ascending order; all of them if n is smaller."""
    chosen = torch.randperm(len(pool), generator=generator(seed, *words))[:count]
    return pool[chosen].sort().values
