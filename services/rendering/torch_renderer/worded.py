"""Perturbations of the torch renderer's groups in sentences, with the files that show them and the lobes' curves."""

from collections.abc import Mapping

from torch import Tensor

from services.rendering.physical_change import Change, ChangedValue, PhysicalChange, number, signed
from services.rendering.protocol import Renderer
from services.rendering.torch_renderer.drawings import images_of, lobe_curves
from services.rendering.torch_renderer.physical import changes, material_changes
from services.scenes.description import object_names
from services.scenes.resolve import ResolvedScene

WORDS = {
    "normals": ("surface normals", "tilted by"),
    "illumination": ("environment map", "its texels changed by"),
    "illumination_rgb": ("environment map", "its texels changed by"),
}
"""What each group changes, and the verb for its change."""


def worded(scene: ResolvedScene, renderer: Renderer, perturbation: Mapping[str, Tensor]) -> list[Change]:
    """A perturbation of the renderer's initial values in words, by group and by channel of the map or object.

    The images of the map are with the first change of it.
    """
    initial = renderer.initial()
    measured: dict[tuple[str, str], list[PhysicalChange]] = {}
    for one in changes(scene, renderer, {group: perturbation[group] for group in WORDS if group in perturbation}):
        measured.setdefault((one.group, one.subject), []).append(one)
    found: list[Change] = []
    for (group, subject), (typical, largest) in measured.items():
        of, verb = WORDS[group]
        name = of if subject in ("surface", "map") else f"{of}, {subject.removeprefix('map, ')}"
        if typical.unit == "degrees":
            sizes = f"{number(typical.value)}° in the root mean square, {number(largest.value)}° at most"
        else:
            sizes = f"{number(typical.value)} {typical.unit} in the root mean square, {signed(largest.value)} % at most"
        values = [_value(one, name) for one in (typical, largest)]
        shown = (
            [] if any(of == one.subject.partition(",")[0] for one in found) else images_of(of, initial, perturbation)
        )
        found.append(Change(group=group, subject=name, sentence=f"{verb} {sizes}", values=values, images=shown))
    if "material" in perturbation:
        names = object_names(scene.description, scene.titles)
        found += map(material, names, initial["material"], perturbation["material"])
    return found


def material(thing: str, initial: Tensor, change: Tensor) -> Change:
    """A change of the material [3, 3, 2, 6] of the object of that name, with the curves of its reflectance."""
    kappa, gamma = material_changes(change[None])
    name = f"material of {thing}"
    return Change(
        group="material",
        subject=name,
        sentence=f"its lobes' κ changed by {signed(kappa.value)} % at most, their γ by {signed(gamma.value)} %",
        values=[_value(one, f"{name}, {symbol}") for one, symbol in ((kappa, "κ"), (gamma, "γ"))],
        curves=lobe_curves(initial, change),
    )


def _value(one: PhysicalChange, name: str) -> ChangedValue:
    return ChangedValue(name=f"{name}, {one.measure}", unit=one.unit, before=0.0, after=one.value)
