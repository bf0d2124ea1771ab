"""A perturbation in physical units and in words: degrees, centimetres and percent, as the renderer declares."""

from pkgutil import resolve_name

from torch import Tensor

from services.errors import named
from services.rendering.declaration import RENDERERS
from services.rendering.physical_change import Change, ChangedValue, PhysicalChange, signed
from services.rendering.protocol import Parameters, Renderer
from services.scenes.resolve import ResolvedScene


def physical_changes(scene: ResolvedScene, renderer: Renderer, perturbation: Parameters) -> list[PhysicalChange]:
    """The changes that a perturbation makes in a scene.

    For a renderer that declares no words for them it is the largest change of a coordinate of each group, in the
    group's own unit.
    """
    declared = RENDERERS[renderer.name]
    if declared.changes is not None:
        with named(f"renderer {renderer.name!r}"):
            changes: list[PhysicalChange] = resolve_name(declared.changes)(scene, renderer.exact(), perturbation)
            return changes
    return [
        PhysicalChange(
            group=group,
            subject=declared.group(group).words,
            measure="largest change",
            value=float(value.flatten()[value.abs().argmax()]),
            unit=declared.group(group).unit,
        )
        for group, value in perturbation.items()
    ]


def changes_in_words(scene: ResolvedScene, renderer: Renderer, perturbation: Parameters) -> list[Change]:
    """Changes that a perturbation made to a scene: a sentence for each thing, and its numbers before and after.

    For a renderer that declares no words of its own, the sentences are made of the physical changes; the numbers
    before are then 0.
    """
    declared = RENDERERS[renderer.name]
    if declared.worded is not None:
        with named(f"renderer {renderer.name!r}"):
            changes: list[Change] = resolve_name(declared.worded)(scene, renderer.exact(), perturbation)
            return changes
    return [
        Change(
            group=change.group,
            subject=change.subject,
            sentence=f"{change.measure} {signed(change.value)} ({change.unit})",
            values=[
                ChangedValue(
                    name=f"{change.subject}, {change.measure}", unit=change.unit, before=0.0, after=change.value
                )
            ],
        )
        for change in physical_changes(scene, renderer, perturbation)
    ]


def change_images(renderer: Renderer, perturbation: Parameters) -> dict[str, Tensor]:
    """Images of what a perturbation changed, uint8 [h, w, 3], by file name; empty if the renderer declares none."""
    declared = RENDERERS[renderer.name]
    if declared.drawn is None:
        return {}
    with named(f"renderer {renderer.name!r}"):
        images: dict[str, Tensor] = resolve_name(declared.drawn)(renderer.exact(), perturbation)
        return images
