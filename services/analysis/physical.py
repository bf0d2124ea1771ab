"""A perturbation in physical units: degrees, centimetres and percent, as the renderer's declaration words it."""

from pkgutil import resolve_name

from services.errors import named
from services.rendering.declaration import RENDERERS
from services.rendering.physical_change import PhysicalChange
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
            found: list[PhysicalChange] = resolve_name(declared.changes)(scene, renderer.exact(), perturbation)
            return found
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
