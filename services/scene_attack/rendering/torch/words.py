"""Perturbations of the torch renderer's groups: in degrees and percent, in sentences, and as images.

The images show the environment map, how normals tilt, and the curves of the lobes.
"""

from collections.abc import Iterator, Mapping
from math import degrees

import torch
from torch import Tensor

from scene_attack.rendering.color import to_bytes, to_display
from scene_attack.rendering.physical_change import (
    Change,
    ChangedValue,
    ChangeImage,
    Curve,
    PhysicalChange,
    Worded,
    from_zero,
    listed,
    number,
    signed,
)
from scene_attack.rendering.pose import poses
from scene_attack.rendering.protocol import Renderer
from scene_attack.rendering.torch import bump, dials, shape
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.dsbrdf import (
    COSINE_FLOOR,
    ILLUMINATION_MEAN,
    MATERIAL_UNIT,
    basis,
    lobes,
    reflectance,
)
from scene_attack.rendering.torch.lamp import physical
from scene_attack.rendering.torch.light import LIGHT_GROUPS
from scene_attack.rendering.torch.paint import cielab
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.rendering.torch.table import to_vectors
from scene_attack.scenes.description import object_names
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene

CHANNELS = ("red", "green", "blue")
MAP_GROUPS = (*LIGHT_GROUPS, "lamp")
"""The groups that change the environment map."""
NOTICEABLE = 0.01
"""Least share of its natural range by which the sentence about a lamp names a number: 0.3°, 0.7 % of the brightness,
1 mired, 1 % of the map's power."""
LAMP_UNITS = {
    "turn": "degrees",
    "brightness": "%",
    "colour temperature": "K",
    "power of the lamp": "% of the map's",
    "azimuth of the lamp": "degrees",
    "elevation of the lamp": "degrees",
    "radius of the lamp": "degrees",
}
"""Units of the numbers of the group `lamp`, in its order."""


def worded(scene: ResolvedScene, renderer: Renderer, perturbation: Mapping[str, Tensor]) -> list[Worded]:
    """A perturbation of the renderer's initial values in words, by group and by channel of the map or object.

    The images of the map are listed with its first change.
    """
    initial = renderer.initial()
    result: list[Worded] = []
    for group, change in perturbation.items():
        if group == "normals":
            result.append(normals(initial[group], change))
        elif group in MAP_GROUPS:
            first = not any(thing.change.group in MAP_GROUPS for thing in result)
            images = images_of_map(*maps(renderer, perturbation)) if first else []
            result += [lamp(change, images)] if group == "lamp" else light(group, change, images)
        elif group == "bump":
            result += dents(scene, renderer, change, "shape" in perturbation)
        elif group == "shape":
            result += bent(scene, renderer, change)
        elif group in TORCH.moving_groups:
            result += poses(scene, group, initial[group].double().numpy(), change.double().numpy())
        elif group == "paint":
            result += painted(scene, renderer, change)
        elif group == "dials":
            result += dials_turned(scene, renderer, change)
        elif group == "material":
            names = object_names(scene.description, scene.titles)
            result += [material(k, name, initial[group][k], change[k]) for k, name in enumerate(names)]
    return result


def normals(initial: Tensor, change: Tensor) -> Worded:
    """Angles by which the normals of angles [H, W, 2] turn, at the pixels that a surface covers."""
    angles = tilts(initial, change)
    typical, largest = sizes = _sizes("normals", "surface", angles[~angles.isnan()], "angle", "degrees")
    most = f"{number(largest.value)}°"
    tilted = Change(
        group="normals",
        subject="surface normals",
        sentence=f"tilted by {number(typical.value)}° in the root mean square, {most} at most",
        values=[from_zero(size, "surface normals") for size in sizes],
        images=[ChangeImage(file="normals-tilt.png", words=f"tilt of the normals, from 0 (violet) to {most} (yellow)")],
    )
    return Worded(tilted, sizes)


def dents(scene: ResolvedScene, renderer: Renderer, change: Tensor, is_bent: bool) -> Iterator[Worded]:
    """Heights and slopes of the dents `change` (scene_attack.rendering.torch.bump), by object, where it is seen before
    it is bent, if it is."""
    assert isinstance(renderer, TorchRenderer)
    places, change = renderer.bump, change.double()
    shares = torch.maximum(bump.steepness(change), change.abs().amax((1, 2, 3)) / bump.LARGEST).clamp_max(1.0)
    heights, slopes = places.heights(change), places.tilts(change) * degrees(1)
    for k, name in enumerate(object_names(scene.description, scene.titles)):
        seen, (size, unit, at_size) = places.shown.object_index == k, length(scene, k)
        if not bool(seen.any()) or not bool(change[k].any()):
            continue
        subject = f"surface of {name}"
        typical, largest = _sizes("bump", subject, size * heights[seen], "height", unit)
        steepest = PhysicalChange(
            group="bump", subject=subject, measure="steepest slope", value=float(slopes[seen].max()), unit="degrees"
        )
        used = share("bump", subject, float(shares[k]))
        most = abs(largest.value)
        dented = Change(
            group="bump",
            subject=subject,
            sentence=f"dented by {number(typical.value)} {unit} in the root mean square, {signed(largest.value)} {unit}"
            f" at most where it is seen{at_size}, with slopes of up to {number(steepest.value)}°"
            f"{' before it is bent' * is_bent}",
            values=[from_zero(value, subject) for value in (typical, largest, steepest, used)],
            images=[
                ChangeImage(
                    file="dents.png", words=f"heights: {number(most)} {unit} is red, {signed(-most)} {unit} blue"
                )
            ],
        )
        yield Worded(dented, [typical, largest, steepest, used])


def bent(scene: ResolvedScene, renderer: Renderer, change: Tensor) -> Iterator[Worded]:
    """Distances by which the shape `change` (scene_attack.rendering.torch.shape) moves points, by object, where it is
    seen before they are moved."""
    assert isinstance(renderer, TorchRenderer)
    surfaces, change = renderer.bump, change.double()
    shares = torch.maximum(shape.steepness(change), change.abs().amax((1, 2, 3, 4)) / shape.LARGEST).clamp_max(1.0)
    distances = surfaces.places.values(shape.limited(change)).norm(dim=-1)
    for k, name in enumerate(object_names(scene.description, scene.titles)):
        seen, (size, unit, at_size) = surfaces.shown.object_index == k, length(scene, k)
        if not bool(seen.any()) or not bool(change[k].any()):
            continue
        subject = f"shape of {name}"
        typical, largest = _sizes("shape", subject, size * distances[seen], "distance", unit)
        used = share("shape", subject, float(shares[k]))
        changed = Change(
            group="shape",
            subject=subject,
            sentence=f"bent by {number(typical.value)} {unit} in the root mean square, {number(largest.value)} {unit}"
            f" at most where it is seen{at_size}",
            values=[from_zero(value, subject) for value in (typical, largest, used)],
            images=[
                ChangeImage(file="shape.png", words=f"distances: from 0, white, to {number(largest.value)} {unit}, red")
            ],
        )
        yield Worded(changed, [typical, largest, used])


def length(scene: ResolvedScene, k: int) -> tuple[float, str, str]:
    """A thousandth of the size of object `k`, the unit of that number, and words for the size where it is known."""
    mesh = scene.meshes[k]
    if mesh.centimetres is None:
        return 0.1, "% of its size", ""
    size = 2 * FIT_RADIUS * mesh.centimetres / 100  # of the real thing, whatever the scale at which it is shown
    return size, "mm", f", at its size of {number(100 * size)} cm"


def share(group: str, subject: str, used: float) -> PhysicalChange:
    """How much of the group's natural range is used, in parts of it."""
    return PhysicalChange(
        group=group, subject=subject, measure="share of the natural range", value=100 * used, unit="%"
    )


def painted(scene: ResolvedScene, renderer: Renderer, change: Tensor) -> Iterator[Worded]:
    """Colours of the paint `change` (scene_attack.rendering.torch.paint), by object, where it is seen."""
    assert isinstance(renderer, TorchRenderer)
    shown, before, after = renderer.paint.shown, *colors_of_paint(renderer, change)
    differences = (cielab(after) - cielab(before)).norm(dim=-1)
    for k, name in enumerate(object_names(scene.description, scene.titles)):
        seen, subject = shown.object_index == k, f"surface of {name}"
        if not bool(seen.any()) or not bool(change[k].any()):
            continue
        typical, largest = _sizes("paint", subject, differences[seen], "difference of colour", "ΔE")
        reflected = _sizes("paint", subject, 100 * (after - before)[seen].flatten(), "channel's change", "% of white")
        used = share("paint", subject, float(change[k].abs().max()))
        sizes = [typical, largest, *reflected, used]
        of_object = Change(
            group="paint",
            subject=subject,
            sentence=f"painted in colours that differ by ΔE {number(typical.value)} in the root mean square, "
            f"{number(largest.value)} at most (CIE 1976), and in a channel by {signed(reflected[1].value)} % of white",
            values=[from_zero(size, subject) for size in sizes],
            images=[ChangeImage(file="paint.png", words="base colours of the painted surface, without light")],
        )
        yield Worded(of_object, sizes)


def colors_of_paint(renderer: TorchRenderer, change: Tensor) -> tuple[Tensor, Tensor]:
    """Linear base colours [P, 3] of the surfaces before and after the paint `change`, float64."""
    before = renderer.paint.shown.base_color.double()
    return before, renderer.paint.colors(before, change.to(before))


def dials_turned(scene: ResolvedScene, renderer: Renderer, change: Tensor) -> Iterator[Worded]:
    """Turns [objects, 5] of the dials of materials (scene_attack.rendering.torch.dials), by object, with the curves of
    its reflectance."""
    assert isinstance(renderer, TorchRenderer)
    before, after = renderer.initial()["material"], renderer.turned(change).cpu()
    for k, name in enumerate(object_names(scene.description, scene.titles)):
        own = change[k].double().tolist()
        if not any(own):
            continue
        subject = f"material of {name}"
        factors = [dials.WIDTH, dials.GLOSS, dials.TINT, dials.TINT, dials.TINT]
        percent = [100 * (factor**value - 1) for factor, value in zip(factors, own, strict=True)]
        measures = ["width of its highlights", "strength of its gloss", *(f"reflectance in {c}" for c in CHANNELS)]
        used = max(abs(value) for value in own)
        sizes = [
            PhysicalChange(group="dials", subject=subject, measure=measure, value=value, unit="%")
            for measure, value in zip(measures, percent, strict=True)
        ]
        sizes.append(share("dials", subject, used))
        words = [
            f"{number(abs(value))} % {more if value > 0 else less}"
            for value, (more, less) in zip(percent, DIAL_WORDS, strict=True)
            if value
        ]
        turned = Change(
            group="dials",
            subject=subject,
            sentence=f"became {listed(words)}, using {number(100 * used)} % of its natural range",
            values=[from_zero(size, subject) for size in sizes],
            curves=lobe_curves(before[k], (after - before)[k]),
        )
        yield Worded(turned, sizes)


DIAL_WORDS = (
    ("wider in its highlights", "narrower in its highlights"),
    ("stronger in its gloss", "weaker in its gloss"),
    *((f"lighter in {channel}", f"darker in {channel}") for channel in CHANNELS),
)
"""Of each dial (`dials.NAMES`), turned up and down."""


def light(group: str, change: Tensor, images: list[ChangeImage]) -> Iterator[Worded]:
    """Changes of the environment map's texels [rows, cols], or of those of each channel [rows, cols, 3], in percent of
    the map's mean intensity. `images` are listed with the first."""
    channels = [""] if group == "illumination" else [f", {channel}" for channel in CHANNELS]
    percent = 100 * change.double() / ILLUMINATION_MEAN
    for channel, texels in zip(channels, percent.reshape(-1, len(channels)).unbind(-1), strict=True):
        subject = f"environment map{channel}"
        typical, largest = sizes = _sizes(group, f"map{channel}", texels, "texel", "% of its mean intensity")
        change_of_channel = Change(
            group=group,
            subject=subject,
            sentence=f"its texels changed by {number(typical.value)} {typical.unit} in the root mean square, "
            f"{signed(largest.value)} % at most",
            values=[from_zero(size, subject) for size in sizes],
            images=images,
        )
        yield Worded(change_of_channel, sizes)
        images = []


def lamp(change: Tensor, images: list[ChangeImage]) -> Worded:
    """The turn, brightness and colour of the environment map and the lamp that is added to it, by values [7] of the
    group (scene_attack.rendering.torch.lamp)."""
    before, after = (_numbers(values) for values in (torch.zeros_like(change), change))
    is_lit = float(change[3]) >= NOTICEABLE
    shown = list(LAMP_UNITS)[: 7 if is_lit else 4]
    subject, used = "environment map", float(change[: len(shown)].abs().max())
    values = [
        ChangedValue(name=f"{subject}, {name}", unit=LAMP_UNITS[name], before=before[name], after=after[name])
        for name in shown
    ]
    measures = {name: (after[name] - before[name], LAMP_UNITS[name]) for name in shown}
    sizes = [
        PhysicalChange(group="lamp", subject="map", measure=name, value=value, unit=unit)
        for name, (value, unit) in measures.items()
    ]
    sizes.append(share("lamp", "map", used))
    values.append(from_zero(sizes[-1], subject))
    sentence = _noticeable(change, before, after) or "changed by less than 1 % of what a room could have"
    return Worded(Change(group="lamp", subject=subject, sentence=sentence, values=values, images=images), sizes)


def _noticeable(change: Tensor, before: Mapping[str, float], after: Mapping[str, float]) -> str:
    """What a change [7] of the group `lamp` makes of the map, as far as it is noticeable."""
    turned, dimmed, tinted, is_lit = (change[:4].abs() >= NOTICEABLE).tolist()
    brighter = after["brightness"] - before["brightness"]
    azimuth = (round(after["azimuth of the lamp"]) + 180) % 360 - 180
    parts = {
        f"turned by {signed(after['turn'])}°": turned,
        f"{number(abs(brighter))} % {'brighter' if brighter > 0 else 'dimmer'}": dimmed,
        f"{after['colour temperature']:,.0f} K in place of {before['colour temperature']:,.0f} K": tinted,
        f"with a lamp of {number(after['power of the lamp'])} % of the map's power at azimuth {'−' * (azimuth < 0)}"
        f"{abs(azimuth)}°, elevation {after['elevation of the lamp']:.0f}°, of "
        f"{after['radius of the lamp']:.0f}° in radius": is_lit,
    }
    return ", ".join(part for part, is_shown in parts.items() if is_shown)


def _numbers(values: Tensor) -> dict[str, float]:
    """Values [7] of the group `lamp` in the units of LAMP_UNITS."""
    numbers = [float(value) for value in physical(values.double().cpu())]
    scales = [100.0 if unit.startswith("%") else 1.0 for unit in LAMP_UNITS.values()]
    return {name: scale * value for name, scale, value in zip(LAMP_UNITS, scales, numbers, strict=True)}


def _sizes(group: str, subject: str, values: Tensor, thing: str, unit: str) -> list[PhysicalChange]:
    """The root mean square of values [n], and the one that is furthest from 0."""
    largest = float(values[values.abs().argmax()])
    return [
        PhysicalChange(group=group, subject=subject, measure=measure, value=value, unit=unit)
        for measure, value in (
            (f"root mean square of the {thing}s", float(values.square().mean().sqrt())),
            (f"largest {thing}", largest),
        )
    ]


def material(index: int, name: str, initial: Tensor, change: Tensor) -> Worded:
    """A change of the material [3, 3, 2, 6] of an object, with the curves of its reflectance: the largest relative
    changes of its lobes' κ and γ.

    A Bernstein polynomial moves by no more than its coefficients, and they are logarithms.
    """
    subject, sizes = f"material of {name}", []
    for symbol, coefficients in zip(("κ", "γ"), change.double().unbind(-2), strict=True):
        # A third (−67 %) is further off than double (+100 %) as a logarithm, and less in percent.
        percent = 100 * torch.expm1(coefficients.flatten() / MATERIAL_UNIT)
        thing, largest = f"object {index} {symbol}", float(percent[percent.abs().argmax()])
        sizes.append(PhysicalChange(group="material", subject=thing, measure="largest change", value=largest, unit="%"))
    kappa, gamma = sizes
    of_lobes = Change(
        group="material",
        subject=subject,
        sentence=f"its lobes' κ changed by {signed(kappa.value)} % at most, their γ by {signed(gamma.value)} %",
        values=[from_zero(kappa, f"{subject}, κ"), from_zero(gamma, f"{subject}, γ")],
        curves=lobe_curves(initial, change),
    )
    return Worded(of_lobes, sizes)


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
    if "bump" in perturbation:
        assert isinstance(renderer, TorchRenderer)
        images["dents.png"] = height_image(renderer, renderer.bump.heights(perturbation["bump"].double()))
    if "shape" in perturbation:
        assert isinstance(renderer, TorchRenderer)
        moved = renderer.bump.places.values(shape.limited(perturbation["shape"].double()))
        images["shape.png"] = height_image(renderer, moved.norm(dim=-1))
    if "paint" in perturbation:
        assert isinstance(renderer, TorchRenderer)
        images["paint.png"] = paint_image(renderer, perturbation["paint"])
    if "normals" in perturbation:
        images["normals-tilt.png"] = tilt_image(tilts(initial["normals"], perturbation["normals"]))
    if any(group in perturbation for group in MAP_GROUPS):
        before, after = maps(renderer, perturbation)
        images |= {"map-before.png": map_image(before), "map-after.png": map_image(after)}
        images["map-ratio.png"] = ratio_image(stops(before, after))
    return images


def height_image(renderer: TorchRenderer, of_surfaces: Tensor) -> Tensor:
    """An image of heights [P] of the surfaces: white 0, red raised, blue pressed in, full at the largest; grey where
    there is none."""
    places = renderer.bump
    height, width = renderer.size
    heights = torch.full((height * width,), torch.nan, dtype=torch.float64)
    first = places.shown.rank == 0
    heights[places.shown.pixels[first].cpu()] = of_surfaces[first].cpu()
    heights = heights.view(height, width)
    return torch.where(heights.isnan()[..., None], GROUND, signed_colours(heights.nan_to_num())).to(torch.uint8)


def paint_image(renderer: TorchRenderer, change: Tensor) -> Tensor:
    """An image of the base colours under the paint `change`, as displayed values; grey where no surface is."""
    shown = renderer.paint.shown
    height, width = renderer.size
    first = shown.rank == 0
    image = torch.full((height * width, 3), GROUND, dtype=torch.uint8)
    image[shown.pixels[first].cpu()] = to_bytes(to_display(colors_of_paint(renderer, change)[1][first].cpu()))
    return image.view(height, width, 3)


def images_of_map(before: Tensor, after: Tensor) -> list[ChangeImage]:
    """The images of a map whose intensities [rows, cols, 3] changed, with words that give their scales."""
    largest = 2 ** float(stops(before, after).abs().max())
    return [
        ChangeImage(file="map-before.png", words="intensities of the environment map before"),
        ChangeImage(file="map-after.png", words="and after"),
        ChangeImage(
            file="map-ratio.png",
            words=f"after divided by before: red is brighter, blue darker; full colour is a factor of {largest:.3g}",
        ),
    ]


def maps(renderer: Renderer, perturbation: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """The map's intensities before and after, as `intensities` has them."""
    initial = renderer.initial()
    changed = [group for group in MAP_GROUPS if group in perturbation]
    values = dict(initial) | {group: initial[group] + perturbation[group] for group in changed}
    if "lamp" in perturbation:
        assert isinstance(renderer, TorchRenderer)
        added = renderer.lamp.added(values["lamp"], values["illumination"])
        values["illumination_rgb"] = values["illumination_rgb"] + added
    return intensities(initial), intensities(values)


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
    return _enlarged(signed_colours(ratios))


def signed_colours(values: Tensor) -> Tensor:
    """Colours, uint8 [h, w, 3], of values [h, w]: white 0, red above, blue below, full at the largest."""
    part = values / (float(values.abs().max()) or 1.0)
    red, blue = 1 - part.clamp(max=0).abs(), 1 - part.clamp(min=0)
    return (255 * torch.stack([red, torch.minimum(red, blue), blue], dim=-1)).round().to(torch.uint8)


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
