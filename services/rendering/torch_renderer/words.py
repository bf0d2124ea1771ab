"""Perturbations of the torch renderer's groups: in degrees and percent, in sentences, and as images.

The images show the environment map, how normals tilt, and the curves of the lobes.
"""

from collections.abc import Iterator, Mapping
from math import degrees

import torch
from torch import Tensor

from services.rendering.physical_change import Change, ChangedValue, ChangeImage, Curve, PhysicalChange, number, signed
from services.rendering.protocol import Renderer
from services.rendering.torch_renderer.dsbrdf import (
    COSINE_FLOOR,
    ILLUMINATION_MEAN,
    MATERIAL_UNIT,
    basis,
    lobes,
    reflectance,
)
from services.rendering.torch_renderer.light import LIGHT_GROUPS
from services.rendering.torch_renderer.table import to_vectors
from services.scenes.description import object_names
from services.scenes.resolve import ResolvedScene

CHANNELS = ("red", "green", "blue")


def changes(
    scene: ResolvedScene,  # noqa: ARG001 - the declaration's signature
    renderer: Renderer,
    perturbation: Mapping[str, Tensor],
) -> list[PhysicalChange]:
    """A perturbation of the renderer's initial values, by group."""
    result: list[PhysicalChange] = []
    for group, change in perturbation.items():
        if group == "normals":
            initial = renderer.initial()[group]
            covered = (initial != 0).any(dim=-1)  # the angles of uncovered pixels are 0
            result += normal_changes(initial, change, covered)
        elif group == "illumination":
            result += map_changes(group, "map", change)
        elif group == "illumination_rgb":
            for channel, values in zip(CHANNELS, change.unbind(-1), strict=True):
                result += map_changes(group, f"map, {channel}", values)
        elif group == "material":
            result += material_changes(change)
    return result


def normal_changes(initial: Tensor, change: Tensor, covered: Tensor) -> Iterator[PhysicalChange]:
    """Angles by which the normals turn, given angles [H, W, 2] and the mask of covered pixels, bool [H, W]."""
    before, after = to_vectors(initial[covered].double()), to_vectors((initial + change)[covered].double())
    angles = 2 * ((after - before).norm(dim=-1) / 2).clamp(max=1).asin()
    for measure, value in (
        ("root mean square of the angles", float(angles.square().mean().sqrt())),
        ("largest angle", float(angles.max())),
    ):
        yield PhysicalChange(group="normals", subject="surface", measure=measure, value=degrees(value), unit="degrees")


def map_changes(group: str, subject: str, change: Tensor) -> Iterator[PhysicalChange]:
    """Changes of the environment map's texels [rows, cols] in one channel or all, in percent of the map's mean
    intensity."""
    percent = 100 * change.double() / ILLUMINATION_MEAN
    for measure, value in (
        ("root mean square of the texels", percent.square().mean().sqrt()),
        ("largest texel", percent.flatten()[percent.abs().argmax()]),
    ):
        yield PhysicalChange(
            group=group, subject=subject, measure=measure, value=float(value), unit="% of its mean intensity"
        )


def material_changes(change: Tensor) -> Iterator[PhysicalChange]:
    """Largest relative changes of the lobes' κ and γ by object, given coefficients [objects, 3, 3, 2, 6].

    A Bernstein polynomial moves by no more than its coefficients, and they are logarithms.
    """
    for index, thing in enumerate(change.double()):
        for word, values in zip(("κ", "γ"), torch.unbind(thing, dim=-2), strict=True):
            # A third (−67 %) is further off than double (+100 %) as a logarithm, and less in percent.
            percent = 100 * torch.expm1(values.flatten() / MATERIAL_UNIT)
            yield PhysicalChange(
                group="material",
                subject=f"object {index} {word}",
                measure="largest change",
                value=float(percent[percent.abs().argmax()]),
                unit="%",
            )


MAP_WIDTH = 512
"""Width of the images of maps, pixels; each texel is a rectangle."""
BRIGHT = 4.0
"""Intensity, in means of the map, that is drawn white."""
LEAST_RATIO = 0.01
"""Smallest intensity in ratios, in means of the map; darker texels count as this."""
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
    images: dict[str, Tensor] = {}
    if "normals" in perturbation:
        images["normals-tilt.png"] = tilt_image(tilts(initial["normals"], perturbation["normals"]))
    if any(group in perturbation for group in LIGHT_GROUPS):
        before, after = maps(initial, perturbation)
        images |= {"map-before.png": map_image(before), "map-after.png": map_image(after)}
        images["map-ratio.png"] = ratio_image(stops(before, after))
    return images


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
    intensity = values["illumination"].double()[..., None].expand(-1, -1, 3)
    if "illumination_rgb" in values:
        intensity = intensity + values["illumination_rgb"].double()
    return intensity / ILLUMINATION_MEAN


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


WORDS = {
    "normals": ("surface normals", "tilted by"),
    "illumination": ("environment map", "its texels changed by"),
    "illumination_rgb": ("environment map", "its texels changed by"),
}
"""The thing that each group changes, and the verb for its change."""


def worded(scene: ResolvedScene, renderer: Renderer, perturbation: Mapping[str, Tensor]) -> list[Change]:
    """A perturbation of the renderer's initial values in words, by group and by channel of the map or object.

    The images of the map are listed with its first change.
    """
    initial = renderer.initial()
    measured: dict[tuple[str, str], list[PhysicalChange]] = {}
    for change in changes(scene, renderer, {group: perturbation[group] for group in WORDS if group in perturbation}):
        measured.setdefault((change.group, change.subject), []).append(change)
    result: list[Change] = []
    for (group, subject), (typical, largest) in measured.items():
        of, verb = WORDS[group]
        name = of if subject in ("surface", "map") else f"{of}, {subject.removeprefix('map, ')}"
        if typical.unit == "degrees":
            sizes = f"{number(typical.value)}° in the root mean square, {number(largest.value)}° at most"
        else:
            sizes = f"{number(typical.value)} {typical.unit} in the root mean square, {signed(largest.value)} % at most"
        values = [_value(change, name) for change in (typical, largest)]
        shown = (
            []
            if any(of == earlier.subject.partition(",")[0] for earlier in result)
            else images_of(of, initial, perturbation)
        )
        result.append(Change(group=group, subject=name, sentence=f"{verb} {sizes}", values=values, images=shown))
    if "material" in perturbation:
        names = object_names(scene.description, scene.titles)
        result += map(material, names, initial["material"], perturbation["material"])
    return result


def material(thing: str, initial: Tensor, change: Tensor) -> Change:
    """A change of the material [3, 3, 2, 6] of the object of that name, with the curves of its reflectance."""
    kappa, gamma = material_changes(change[None])
    name = f"material of {thing}"
    return Change(
        group="material",
        subject=name,
        sentence=f"its lobes' κ changed by {signed(kappa.value)} % at most, their γ by {signed(gamma.value)} %",
        values=[_value(lobe_change, f"{name}, {symbol}") for lobe_change, symbol in ((kappa, "κ"), (gamma, "γ"))],
        curves=lobe_curves(initial, change),
    )


def _value(change: PhysicalChange, name: str) -> ChangedValue:
    return ChangedValue(name=f"{name}, {change.measure}", unit=change.unit, before=0.0, after=change.value)
