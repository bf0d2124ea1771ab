"""The paper's perceptibility p, a measure of how visible a change is, for images and parameter groups (section 3.3).

p of an image is taken twice: on the float images, as the paper's is, and on the images as they are saved, of 8 bits.
The two differ where a change is smaller than a step of 1/255: a change of 0.002 of every value has p 3.5e-3, and p
6.8e-3 once it is saved, because each value is rounded to the next step.
"""

from math import sqrt

import torch
from torch import Tensor

from services.rendering.declaration import RENDERERS
from services.rendering.protocol import Parameters

FULL_RANGE = sqrt(3)
"""Largest p of an image, that of black against white: the squared norm of an RGB change is at most 3."""


def perceptibility(change: Tensor, vector_axes: int = 1) -> float:
    """p = sqrt(mean of ‖Δ‖²), in float64. Δ is a vector along the last `vector_axes` axes; the mean is over the others.

    For the change of an image, [H, W, 3], the mean is over pixels.
    """
    squares = change.detach().double().square()
    if vector_axes:
        squares = squares.flatten(-vector_axes).sum(dim=-1)
    return float(squares.mean().sqrt())


def of_float_images(original: Tensor, attacked: Tensor) -> float:
    """p(ΔY) of two images [H, W, 3] in [0,1] before they are rounded: the paper's p, from 0 to `FULL_RANGE`."""
    return perceptibility(attacked.double() - original.double())


def of_images(original: Tensor, attacked: Tensor) -> float:
    """p(ΔY) of two saved images, uint8 [H, W, 3], with RGB values scaled to [0,1]: from 0 to `FULL_RANGE`."""
    return perceptibility((attacked.double() - original.double()) / 255)


def of_groups(renderer: str, perturbation: Parameters) -> dict[str, float]:
    """p of each group of a perturbation, in the group's units. `renderer` is the name of a registered renderer."""
    declared = RENDERERS[renderer]
    return {name: perceptibility(value, declared.group(name).vector_axes) for name, value in perturbation.items()}


def beyond(original: Tensor, attacked: Tensor, limit: int) -> int:
    """The number of pixels with a channel that differs by more than `limit` 8-bit steps; images are uint8 [H, W, 3]."""
    moved = (attacked.to(torch.int16) - original.to(torch.int16)).abs()
    return int((moved > limit).any(dim=-1).sum())
