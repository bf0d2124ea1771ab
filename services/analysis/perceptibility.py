"""How much of a change can be seen: the paper's p, for images and for every parameter group (section 3.3)."""

import torch
from torch import Tensor

from services.rendering.declaration import RENDERERS
from services.rendering.protocol import Parameters


def perceptibility(change: Tensor, vector_axes: int = 1) -> float:
    """p = sqrt(mean of ‖Δ‖²), in float64: Δ is a vector along the last `vector_axes` axes, the mean is over the others.

    For an image's change [H, W, 3] that is the mean over pixels.
    """
    squares = change.detach().double().square()
    if vector_axes:
        squares = squares.flatten(-vector_axes).sum(dim=-1)
    return float(squares.mean().sqrt())


def of_images(original: Tensor, attacked: Tensor) -> float:
    """p(ΔY) between two saved images, uint8 [H, W, 3]."""
    return perceptibility((attacked.double() - original.double()) / 255)


def of_groups(renderer: str, perturbation: Parameters) -> dict[str, float]:
    """p of each group of a perturbation, in the group's own units."""
    declared = RENDERERS[renderer]
    return {name: perceptibility(value, declared.group(name).vector_axes) for name, value in perturbation.items()}


def beyond(original: Tensor, attacked: Tensor, limit: int) -> int:
    """Pixels of which some channel moved by more than `limit` 8-bit steps; uint8 [H, W, 3]."""
    moved = (attacked.to(torch.int16) - original.to(torch.int16)).abs()
    return int((moved > limit).any(dim=-1).sum())
