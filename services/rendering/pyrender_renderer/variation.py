"""Variations that the pyrender renderer can draw: the view, and the energy of its lights."""

from collections.abc import Mapping

import torch
from torch import Tensor

from services.rendering.protocol import Parameters, Renderer
from services.rendering.variation import Variation


def varied(renderer: Renderer, parameters: Mapping[str, Tensor], variation: Variation) -> Parameters:
    """The values [B, …] by group under a variation. Ambient light and energies are multiplied; lights stay in place."""
    names = renderer.names("illumination") or []
    energies = [name == "ambient" or name.endswith("energy") for name in names]
    light, camera = parameters["illumination"], parameters["camera"]
    factor = torch.where(torch.tensor(energies), variation.intensity, 1.0).to(light.dtype)
    turned = torch.tensor([variation.azimuth, variation.elevation, 0.0, variation.roll], dtype=camera.dtype)
    scaled = torch.tensor([1.0, 1.0, variation.distance, 1.0], dtype=camera.dtype)
    return dict(parameters) | {"illumination": light * factor, "camera": camera * scaled + turned}
