"""Perturbations of the pyrender renderer's groups in degrees, centimetres and percent."""

from collections.abc import Iterator, Mapping, Sequence
from math import degrees

import numpy as np
from torch import Tensor

from services.rendering.physical_change import PhysicalChange
from services.rendering.protocol import Renderer
from services.scenes.mesh import Doubles
from services.scenes.resolve import ResolvedScene
from services.scenes.view import rotation_matrix

SCALES = ("ambient", "energy")
"""The coordinates of a light that scale its radiance; the others are its position or its direction."""


def changes(scene: ResolvedScene, renderer: Renderer, perturbation: Mapping[str, Tensor]) -> list[PhysicalChange]:
    """A perturbation of the renderer's initial values, by group and by light or object.

    Lengths are in centimetres where the meshes' real size is known, and in scene units otherwise. With several objects
    that is known for each object, but not for the lights, since every mesh is scaled to the same size.
    """
    objects = scene.description.objects
    lengths = [
        None if mesh.centimetres is None else mesh.centimetres / placed.scale
        for mesh, placed in zip(scene.meshes, objects, strict=True)
    ]
    initial = {group: value.double().numpy() for group, value in renderer.initial().items()}
    found: list[PhysicalChange] = []
    for group, moved in perturbation.items():
        change = moved.double().numpy()
        if group == "illumination":
            names = renderer.names(group) or []
            found += light_changes(names, initial[group], change, lengths[0] if len(lengths) == 1 else None)
        elif group == "color":
            found += color_changes(change)
        elif group == "translation":
            found += translation_changes(change, lengths)
        elif group == "rotation":
            found += rotation_changes(initial[group], change)
        elif group == "camera":
            found += camera_changes(change, lengths[0] if len(lengths) == 1 else None)
    return found


def light_changes(
    names: Sequence[str], initial: Doubles, change: Doubles, centimetres: float | None
) -> Iterator[PhysicalChange]:
    """Changes of the group `illumination`, whose coordinates [n] have these names ("point 0 energy").

    `centimetres` is the length of a scene unit, or None if it has none. Energies that were 0 are left out.
    """
    places: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        light, _, word = name.rpartition(" ")
        if word in SCALES:
            if initial[index] > 0:
                percent = 100 * float(change[index] / initial[index])
                yield PhysicalChange(group="illumination", subject=name, measure="change", value=percent, unit="%")
        else:
            places.setdefault(light, []).append(index)
    for subject, at in places.items():
        if subject.endswith("direction"):
            yield _angle("illumination", subject, _angle_between(initial[at], initial[at] + change[at]))
        else:
            yield _distance("illumination", subject, change[at], centimetres)


def color_changes(change: Doubles) -> Iterator[PhysicalChange]:
    """Changes of the colour factors [objects, 3]: the largest of the three channels, in percent of the full range."""
    for index, row in enumerate(change):
        value = 100 * float(row[np.abs(row).argmax()])
        yield PhysicalChange(
            group="color", subject=f"object {index}", measure="largest channel", value=value, unit="% of full range"
        )


def translation_changes(change: Doubles, centimetres: Sequence[float | None]) -> Iterator[PhysicalChange]:
    """Distances by which objects move, given translations [objects, 3] and each object's centimetres per unit."""
    for index, (row, length) in enumerate(zip(change, centimetres, strict=True)):
        yield _distance("translation", f"object {index}", row, length)


def rotation_changes(initial: Doubles, change: Doubles) -> Iterator[PhysicalChange]:
    """Angles by which objects turn from their own poses, given rotation vectors [objects, 3]."""
    before, after = rotation_matrix(initial), rotation_matrix(initial + change)
    for index, (old, new) in enumerate(zip(before, after, strict=True)):
        # ‖A − B‖ = 2 √2 sin(θ/2) for the rotation by θ that leads from A to B; precise for small angles, as the
        # arccosine of the trace is not
        sine = float(np.linalg.norm(new - old)) / (2 * np.sqrt(2))
        yield _angle("rotation", f"object {index}", 2 * float(np.arcsin(min(1.0, sine))))


def camera_changes(change: Doubles, centimetres: float | None) -> Iterator[PhysicalChange]:
    """Changes of azimuth, elevation, distance and roll [4]: signed angles, and how far the distance changes."""
    azimuth, elevation, distance, roll = (float(value) for value in change)
    for word, value in (("azimuth", azimuth), ("elevation", elevation), ("roll", roll)):
        yield _angle("camera", word, value)
    yield _distance("camera", "camera", np.array([distance]), centimetres)


def _angle_between(first: Doubles, second: Doubles) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))


def _angle(group: str, subject: str, radians: float) -> PhysicalChange:
    return PhysicalChange(group=group, subject=subject, measure="angle", value=degrees(radians), unit="degrees")


def _distance(group: str, subject: str, change: Doubles, centimetres: float | None) -> PhysicalChange:
    units = float(np.linalg.norm(change))
    value, unit = (units, "scene units") if centimetres is None else (units * centimetres, "cm")
    return PhysicalChange(group=group, subject=subject, measure="distance", value=value, unit=unit)
