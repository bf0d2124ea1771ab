"""How much of a change can be seen: the paper's p, for pictures and for every parameter group (section 3.3)."""

import torch
from torch import Tensor

from services.rendering.protocol import Parameters

VECTOR_DIMENSIONS = {
    "image": {"image": 1},
    "torch": {"normals": 1, "illumination": 0, "material": 2},
    "pyrender": {"illumination": 1, "color": 1, "translation": 1, "rotation": 1},
}
"""How many trailing dimensions of a group are one vector; the mean runs over the others.

A pixel's two angles, a texel's intensity, a lobe's 12 numbers, an object's three.
"""


def perceptibility(change: Tensor, vector_dimensions: int = 1) -> float:
    """p = sqrt(mean over places of ‖Δ‖²), in float64. For a picture's change [H, W, 3] a place is a pixel."""
    squares = change.detach().double().square()
    if vector_dimensions:
        squares = squares.flatten(-vector_dimensions).sum(dim=-1)
    return float(squares.mean().sqrt())


def of_pictures(original: Tensor, attacked: Tensor) -> float:
    """p(ΔY) between two saved pictures, uint8 [H, W, 3]."""
    return perceptibility((attacked.double() - original.double()) / 255)


def of_groups(renderer: str, perturbation: Parameters) -> dict[str, float]:
    """p of each group of a perturbation, in the group's own units."""
    return {group: perceptibility(value, VECTOR_DIMENSIONS[renderer][group]) for group, value in perturbation.items()}


def beyond(original: Tensor, attacked: Tensor, limit: int) -> int:
    """Pixels of which some channel moved by more than `limit` 8-bit steps; uint8 [H, W, 3]."""
    moved = (attacked.to(torch.int16) - original.to(torch.int16)).abs()
    return int((moved > limit).any(dim=-1).sum())
