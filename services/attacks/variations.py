"""Draws variations of a scene from the range of an expectation."""

from math import radians

import torch

from services.attacks.expectation import Expectation
from services.attacks.seeds import derived, generator
from services.rendering.variation import Variation


def draw_variation(asked: Expectation, seed: int, *words: str | int) -> Variation:
    """A variation from the range, which depends on the seed and on `words` alone."""
    random = generator(seed, "variation", *words)
    around = (2 * torch.rand(5, generator=random, dtype=torch.float64) - 1).tolist()
    return Variation(
        azimuth=radians(asked.azimuth) * around[0],
        elevation=radians(asked.elevation) * around[1],
        roll=radians(asked.roll) * around[2],
        distance=1 + asked.distance * around[3],
        intensity=1 + asked.intensity * around[4],
        noise=asked.noise / 255,
        seed=derived(seed, "camera noise", *words),
    )
