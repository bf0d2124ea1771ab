"""A variation of a scene: the same scene from another view, under stronger or weaker light, or by another camera.

A renderer declares which kinds of variation it can draw, and the group that each moves (`Declaration.varies`), and a
function that moves the values (`Declaration.varied`). Noise is added to the image of any renderer.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pkgutil import resolve_name

from torch import Tensor

from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.rendering.sensor.photograph import photographed
from scene_attack.rendering.sensor.settings import PLAIN, Sensor


@dataclass(frozen=True)
class Variation:
    """A view, a light and a camera, relative to the scene's own."""

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
    sensor: Sensor = PLAIN
    """How the camera takes the image."""
    seed: int = 0
    """Seed of its noise."""


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
    if declared.varied is None or replace(variation, sensor=PLAIN, seed=0) == STILL:
        return dict(parameters)
    count, initial = len(next(iter(parameters.values()))), renderer.initial()
    needed = {group for kind, group in declared.varies.items() if getattr(variation, kind) != getattr(STILL, kind)}
    added = {group: initial[group].expand(count, *initial[group].shape) for group in sorted(needed)}
    values: Parameters = resolve_name(declared.varied)(renderer, added | dict(parameters), variation)
    return values


def taken(images: Tensor, variation: Variation) -> Tensor:
    """The images [B, H, W, 3] in [0,1] as the variation's camera takes them; the noise is the same for all."""
    return photographed(images, variation.sensor, variation.seed)
