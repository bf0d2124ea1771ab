"""A variation of a scene: the same scene from another view, under stronger or weaker light, or with camera noise.

A renderer declares which kinds of variation it can draw, and the group that each moves (`Declaration.varies`), and a
function that moves the values (`Declaration.varied`). Noise is added to the image of any renderer.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pkgutil import resolve_name

import torch
from torch import Tensor

from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.protocol import Parameters, Renderer


@dataclass(frozen=True)
class Variation:
    """A view, a light and a camera's noise, relative to the scene's own."""

    azimuth: float = 0.0
    """Added to the camera's azimuth, radians."""
    elevation: float = 0.0
    """Added to its elevation, radians."""
    roll: float = 0.0
    """Added to its roll, radians."""
    distance: float = 1.0
    """Factor on its distance."""
    intensity: float = 1.0
    """Factor on all light."""
    noise: float = 0.0
    """Standard deviation of the noise of each value of the image, in [0,1]."""
    seed: int = 0
    """Seed of the noise."""


STILL = Variation()
"""The scene itself."""


def varied(renderer: Renderer, parameters: Mapping[str, Tensor], variation: Variation) -> Parameters:
    """Returns the values to render, [B, …] by group, under a variation. Groups that it moves are added, and clamped to
    the renderer's bounds.
    """
    values, bounds = moved(renderer, parameters, variation), renderer.bounds()
    groups = RENDERERS[renderer.name].varies.values()
    return {
        group: value.clamp(*(bound.to(value.dtype) for bound in bounds[group])) if group in groups else value
        for group, value in values.items()
    }


def moved(renderer: Renderer, parameters: Mapping[str, Tensor], variation: Variation) -> Parameters:
    """Returns the same as `varied`, not clamped to the bounds."""
    declared = RENDERERS[renderer.name]
    if declared.varied is None or replace(variation, noise=0.0, seed=0) == STILL:
        return dict(parameters)
    count, initial = len(next(iter(parameters.values()))), renderer.initial()
    needed = {group for kind, group in declared.varies.items() if getattr(variation, kind) != getattr(STILL, kind)}
    added = {group: initial[group].expand(count, *initial[group].shape) for group in sorted(needed)}
    values: Parameters = resolve_name(declared.varied)(renderer, added | dict(parameters), variation)
    return values


def noisy(images: Tensor, variation: Variation) -> Tensor:
    """The images [B, H, W, 3] with the variation's noise, the same for all, kept in [0,1]."""
    if variation.noise == 0:
        return images
    random = torch.Generator().manual_seed(variation.seed)
    noise = variation.noise * torch.randn(images.shape[1:], generator=random, dtype=torch.float64)
    return (images + noise.to(images)).clamp(0, 1)
