"""Images of what a perturbation of the torch renderer's groups changed: the environment map, and how normals tilt."""

from collections.abc import Mapping
from math import degrees

import torch
from torch import Tensor

from services.rendering.physical_change import ChangeImage, Curve, number
from services.rendering.protocol import Renderer
from services.rendering.torch_renderer.dsbrdf import COSINE_FLOOR, basis, lobes, reflectance
from services.rendering.torch_renderer.environment_light import LIGHT_GROUPS
from services.rendering.torch_renderer.normals import to_vectors
from services.rendering.torch_renderer.units import ILLUMINATION_MEAN, MATERIAL_UNIT

CHANNELS = ("red", "green", "blue")
MAP_WIDTH = 512
"""Width of the images of maps, pixels; each texel is a rectangle."""
BRIGHT = 4.0
"""Intensity, in means of the map, that is drawn white."""
LEAST_RATIO = 0.01
"""Intensity, in means of the map, below which a ratio is not told."""
LIGHT = 45.0
"""Angle of incidence of the light of the lobes' curves, degrees."""
VIEWERS = tuple(float(angle) for angle in range(-85, 90, 5))
"""Angles from the normal at which they are evaluated, degrees; at +45° is the mirror direction."""
GROUND = 128
"""Value of pixels without a surface."""
SCALE = torch.tensor([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], dtype=torch.float64)
"""Five colours of viridis, from 0 to the largest value."""


def drawn(renderer: Renderer, perturbation: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Images, uint8 [h, w, 3], by file name, of those groups that can be drawn."""
    initial = renderer.initial()
    found: dict[str, Tensor] = {}
    if "normals" in perturbation:
        found["normals-tilt.png"] = tilt_image(tilts(initial["normals"], perturbation["normals"]))
    if any(group in perturbation for group in LIGHT_GROUPS):
        before, after = maps(initial, perturbation)
        found |= {"map-before.png": map_image(before), "map-after.png": map_image(after)}
        found["map-ratio.png"] = ratio_image(stops(before, after))
    return found


def images_of(subject: str, initial: Mapping[str, Tensor], perturbation: Mapping[str, Tensor]) -> list[ChangeImage]:
    """The images of a changed subject, "surface normals" or "environment map", with words that give their scales."""
    if subject == "surface normals":
        largest = float(tilts(initial["normals"], perturbation["normals"]).nan_to_num().max())
        return [
            ChangeImage(
                file="normals-tilt.png", words=f"tilt of the normals, from 0 (violet) to {number(largest)}° (yellow)"
            )
        ]
    before, after = maps(initial, perturbation)
    largest = 2 ** float(stops(before, after).abs().max())
    return [
        ChangeImage(file="map-before.png", words="intensities of the environment map before"),
        ChangeImage(file="map-after.png", words="and after"),
        ChangeImage(
            file="map-ratio.png",
            words=f"after divided by before: red is brighter, blue darker; full colour is a factor of {largest:.3g}",
        ),
    ]


def maps(initial: Mapping[str, Tensor], perturbation: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """The map's intensities before and after, as `intensities` has them."""
    changed = {group: initial[group] + perturbation[group] for group in LIGHT_GROUPS if group in perturbation}
    return intensities(initial), intensities(dict(initial) | changed)


def tilts(initial: Tensor, change: Tensor) -> Tensor:
    """Angles [H, W], degrees, by which the normals of angles [H, W, 2] turn; NaN where there is no surface."""
    before, after = to_vectors(initial.double()), to_vectors((initial + change).double())
    angles = 2 * ((after - before).norm(dim=-1) / 2).clamp(max=1).asin()
    return torch.where((initial != 0).any(dim=-1), angles * degrees(1), torch.nan)


def tilt_image(angles: Tensor) -> Tensor:
    """An image of angles [H, W], coloured from 0 to the largest; grey where they are NaN."""
    largest = float(angles.nan_to_num().max()) or 1.0
    place = angles.nan_to_num() / largest * (len(SCALE) - 1)
    low = place.floor().clamp(0, len(SCALE) - 2).long()
    part = (place - low)[..., None]
    colours = SCALE[low] * (1 - part) + SCALE[low + 1] * part
    return torch.where(angles.isnan()[..., None], float(GROUND), colours).round().to(torch.uint8)


def intensities(values: Mapping[str, Tensor]) -> Tensor:
    """A map's intensities by channel [rows, cols, 3], of values of the groups, in means of the unperturbed map."""
    found = values["illumination"].double()[..., None].expand(-1, -1, 3)
    if "illumination_rgb" in values:
        found = found + values["illumination_rgb"].double()
    return found / ILLUMINATION_MEAN


def map_image(intensity: Tensor) -> Tensor:
    """An image of intensities [rows, cols, 3], in means; each texel is a rectangle."""
    shown = (intensity / BRIGHT).clamp(0, 1) ** (1 / 2.2)
    return _enlarged((255 * shown).round().to(torch.uint8))


def stops(before: Tensor, after: Tensor) -> Tensor:
    """The mean over the channels of log₂(after / before) [rows, cols]; dark texels count as `LEAST_RATIO`."""
    return (after.clamp_min(LEAST_RATIO) / before.clamp_min(LEAST_RATIO)).log2().mean(dim=-1)


def ratio_image(ratios: Tensor) -> Tensor:
    """An image of logarithms of ratios [rows, cols]: white 0, red above, blue below, full at the largest."""
    part = ratios / (float(ratios.abs().max()) or 1.0)
    red, blue = 1 - part.clamp(max=0).abs(), 1 - part.clamp(min=0)
    return _enlarged((255 * torch.stack([red, torch.minimum(red, blue), blue], dim=-1)).round().to(torch.uint8))


def _enlarged(image: Tensor) -> Tensor:
    times = max(1, MAP_WIDTH // image.shape[1])
    return image.repeat_interleave(times, dim=0).repeat_interleave(times, dim=1)


def lobe_curves(initial: Tensor, change: Tensor) -> list[Curve]:
    """The reflectance of a material [3, 3, 2, 6] before and after a change, by channel, at `VIEWERS` for light at
    `LIGHT` in the plane of incidence, in 1/steradian."""
    before, after = reflectances(initial), reflectances(initial + change)
    return [
        Curve(name=channel, angles=list(VIEWERS), before=before[k].tolist(), after=after[k].tolist())
        for k, channel in enumerate(CHANNELS)
    ]


def reflectances(material: Tensor) -> Tensor:
    """Reflectance [3, viewers] of a material's coordinates [3, 3, 2, 6]."""
    viewers = torch.tensor(VIEWERS, dtype=torch.float64).deg2rad()
    light = torch.tensor(LIGHT, dtype=torch.float64).deg2rad()
    theta_h, theta_d = (viewers - light).abs() / 2, (viewers + light).abs() / 2
    log_kappa, gamma = lobes(material.double() / MATERIAL_UNIT, basis(theta_d))
    return reflectance(theta_h.cos().clamp_min(COSINE_FLOOR).log(), log_kappa, gamma).sum(dim=1)
