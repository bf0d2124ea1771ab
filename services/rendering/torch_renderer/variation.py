"""Variations that the torch renderer can draw: the intensity of its map.

Its normals belong to the pixels of one view, so that it can draw no other. Nor can it turn the map, since each texel of
the group `illumination` keeps its colour.
"""

from collections.abc import Mapping

from torch import Tensor

from services.rendering.protocol import Parameters, Renderer
from services.rendering.torch_renderer.light import LIGHT_GROUPS
from services.rendering.variation import Variation


def varied(renderer: Renderer, parameters: Mapping[str, Tensor], variation: Variation) -> Parameters:  # noqa: ARG001
    """The values [B, …] by group under a variation: all light is scaled, what is attacked in one channel too."""
    return {
        group: value * variation.intensity if group in LIGHT_GROUPS else value for group, value in parameters.items()
    }
