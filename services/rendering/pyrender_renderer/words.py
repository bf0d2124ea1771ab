"""Perturbations of the pyrender renderer's groups: in degrees, centimetres and percent, and in sentences: "moved 4.2 cm
right", "turned 6.5°", "23 % dimmer".

Right, left, up and down are those of the unperturbed image; towards and away are along the camera's line of sight.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import degrees

import numpy as np
from torch import Tensor

from services.rendering.physical_change import Change, ChangedValue, PhysicalChange, listed, number, signed
from services.rendering.protocol import Renderer
from services.rendering.pyrender_renderer.parameters import ENERGY, IRRADIANCE
from services.scenes.description import object_names
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
    result: list[PhysicalChange] = []
    for group, moved in perturbation.items():
        change = moved.double().numpy()
        if group == "illumination":
            names = renderer.names(group) or []
            result += light_changes(names, initial[group], change, lengths[0] if len(lengths) == 1 else None)
        elif group == "color":
            result += color_changes(change)
        elif group == "translation":
            result += translation_changes(change, lengths)
        elif group == "rotation":
            result += rotation_changes(initial[group], change)
        elif group == "camera":
            result += camera_changes(change, lengths[0] if len(lengths) == 1 else None)
    return result


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
    """Changes of azimuth, elevation, distance and roll [4]: signed angles, and the change of the distance."""
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


CHANNELS = ("red", "green", "blue")
LAMPS = {"point": "lamp", "directional": "distant lamp", "spot": "spotlight"}
FACTORS = {"point": ENERGY, "spot": ENERGY, "directional": IRRADIANCE}
"""Energy of a light whose coordinate is 1."""
DIRECTIONS = (("left", "right"), ("down", "up"), ("away from the camera", "towards the camera"))
"""Words for the camera's axes, each for the negative and the positive direction."""
SMALL = 0.1
"""Part of a movement below which one of its directions is not named."""
NEARLY = 0.95
"""Cosine of the angle (18°) up to which an axis counts as that of which it has the name."""


def worded(scene: ResolvedScene, renderer: Renderer, perturbation: Mapping[str, Tensor]) -> list[Change]:
    """A perturbation of the renderer's initial values in words, by group and by object or light.

    Lengths are in centimetres where the meshes' real size is known, and in scene units otherwise.
    """
    things = scene.description.objects
    lengths = [
        None if mesh.centimetres is None else mesh.centimetres / placed.scale
        for mesh, placed in zip(scene.meshes, things, strict=True)
    ]
    around = lengths[0] if len(lengths) == 1 else None
    names, axes = object_names(scene.description, scene.titles), scene.view[:3, :3].T
    result: list[Change] = []
    for group, moved in perturbation.items():
        initial, change = renderer.initial()[group].double().numpy(), moved.double().numpy()
        if group == "illumination":
            result += lights(renderer.names(group) or [], initial, change, around, axes)
        elif group == "color":
            result += [color(name, k, initial[k], change[k]) for k, name in enumerate(names)]
        elif group == "translation":
            result += [translation(name, k, initial[k], change[k], lengths[k], axes) for k, name in enumerate(names)]
        elif group == "rotation":
            result += [rotation(name, k, initial[k], change[k], axes) for k, name in enumerate(names)]
        elif group == "camera":
            result.append(camera(initial, change, around))
    return result


def translation(
    subject: str, index: int, initial: Doubles, change: Doubles, centimetres: float | None, axes: Doubles
) -> Change:
    """An object's move by `change` [3] in scene units; rows of `axes` [3, 3] are the camera's right, up and back."""
    unit, scale = _length(centimetres)
    values = [
        _value(f"object {index} translation {axis}", unit, initial[k] * scale, (initial[k] + change[k]) * scale)
        for k, axis in enumerate("xyz")
    ]
    return Change(group="translation", subject=subject, sentence=moved(change, centimetres, axes), values=values)


def moved(change: Doubles, centimetres: float | None, axes: Doubles) -> str:
    """A movement by a vector [3] of scene units in words, e.g. "moved 4.2 cm right and 1.1 cm up"."""
    unit, scale = _length(centimetres)
    along = axes @ change * scale
    size = float(np.linalg.norm(along))
    if size == 0:
        return "did not move"
    words = [
        f"{number(abs(value))} {unit} {words[int(value > 0)]}"
        for value, words in zip(along, DIRECTIONS, strict=True)
        if abs(value) >= SMALL * size
    ]
    return "moved " + listed(words)


def rotation(subject: str, index: int, initial: Doubles, change: Doubles, axes: Doubles) -> Change:
    """An object's turn from its own pose, given rotation vectors [3]."""
    turn = rotation_matrix(initial + change) @ rotation_matrix(initial).T
    # the axis times twice the sine of the angle; with the trace it gives the angle precisely at any size
    twice = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(twice))
    angle = float(np.arctan2(sine, float(np.trace(turn)) - 1))
    sentence = "did not turn" if angle == 0 else turned(angle, twice / (sine or 1.0), axes)
    values = [
        _value(f"object {index} rotation {axis}", "degrees", degrees(initial[k]), degrees(initial[k] + change[k]))
        for k, axis in enumerate("xyz")
    ]
    return Change(group="rotation", subject=subject, sentence=sentence, values=values)


def turned(angle: float, axis: Doubles, axes: Doubles) -> str:
    """A turn by an angle in radians about a unit vector [3] in words, e.g. "turned 6.5° clockwise seen from above"."""
    size = f"{number(degrees(angle))}°"
    for direction, words in ((np.array([0.0, 1.0, 0.0]), "seen from above"), (axes[2], "in the image")):
        cosine = float(axis @ direction)
        if abs(cosine) >= NEARLY:
            return f"turned {size} {'anticlockwise' if cosine > 0 else 'clockwise'} {words}"
    cosine = float(axis @ axes[0])
    if abs(cosine) >= NEARLY:
        return f"tipped {size} {DIRECTIONS[2][int(cosine > 0)]}"
    return f"turned {size} about a slanted axis"


def color(subject: str, index: int, initial: Doubles, change: Doubles) -> Change:
    """A change of an object's linear colour factors [3], each in percent of what it was."""
    words = [
        f"{channel} {signed(100 * change[k] / initial[k])} %" if initial[k] else f"{channel} from 0 to {change[k]:.3g}"
        for k, channel in enumerate(CHANNELS)
    ]
    values = [
        _value(f"object {index} color {channel}", "linear factor", initial[k], initial[k] + change[k])
        for k, channel in enumerate(CHANNELS)
    ]
    sentence = ", ".join(words) if change.any() else "has its colour as before"
    return Change(group="color", subject=subject, sentence=sentence, values=values)


def lights(
    names: Sequence[str], initial: Doubles, change: Doubles, centimetres: float | None, axes: Doubles
) -> Iterator[Change]:
    """Changes of the group `illumination`, whose coordinates [n] have these names ("point 0 energy"), by light."""
    places: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        places.setdefault(" ".join(name.split()[:2]), []).append(index)
    kinds = Counter(light.split()[0] for light in places)
    for light, at in places.items():
        kind, _, which = light.partition(" ")
        lamp = LAMPS.get(kind)
        subject = "ambient light" if lamp is None else lamp if kinds[kind] == 1 else f"{lamp} {which}"
        position = [i for i in at if names[i].split()[-1] in "xyz" and " direction " not in names[i]]
        direction = [i for i in at if " direction " in names[i]]
        parts = [brightness(initial[at[0]], change[at[0]])]
        factor = FACTORS.get(kind, 1.0)
        values = [
            _value(
                names[at[0]],
                "radiance" if lamp is None else "energy",
                factor * initial[at[0]],
                factor * (initial[at[0]] + change[at[0]]),
            )
        ]
        if position:
            parts.append(moved(change[position], centimetres, axes))
            unit, scale = _length(centimetres)
            values += [_value(names[i], unit, scale * initial[i], scale * (initial[i] + change[i])) for i in position]
        if direction:
            old, new = initial[direction], initial[direction] + change[direction]
            angle = float(np.arctan2(np.linalg.norm(np.cross(old, new)), old @ new))
            parts.append(f"its direction turned {number(degrees(angle))}°")
            after = new / (np.linalg.norm(new) or 1.0)
            values += [_value(names[i], "unit vector", old[k], after[k]) for k, i in enumerate(direction)]
        yield Change(group="illumination", subject=subject, sentence=listed(parts), values=values)


def brightness(initial: float, change: float) -> str:
    """A change of a light's radiance or energy, e.g. "23 % dimmer"."""
    if initial == 0:
        return "is no longer dark" if change else "is dark as before"
    percent = 100 * change / initial
    if percent == 0:
        return "as bright as before"
    return f"{number(abs(percent))} % {'brighter' if percent > 0 else 'dimmer'}"


def camera(initial: Doubles, change: Doubles, centimetres: float | None) -> Change:
    """A change of the camera's azimuth, elevation, distance and roll [4]."""
    unit, scale = _length(centimetres)
    words = [
        (degrees(change[0]), "°", ("left", "right"), " around the scene"),
        (degrees(change[1]), "°", ("down", "up"), " around the scene"),
        (change[2] * scale, f" {unit}", ("nearer", "farther"), ""),
    ]
    moves = [f"{number(abs(size))}{of} {pair[int(size > 0)]}{around}" for size, of, pair, around in words if size]
    parts = ["moved " + listed(moves)] if moves else []
    if change[3]:
        parts.append(f"rolled {number(abs(degrees(change[3])))}° to its {'left' if change[3] > 0 else 'right'}")
    labels = ("azimuth", "elevation", "distance", "roll")
    factors = (degrees(1), degrees(1), scale, degrees(1))
    values = [
        _value(f"camera {label}", unit if label == "distance" else "degrees", factor * old, factor * (old + by))
        for label, factor, old, by in zip(labels, factors, initial, change, strict=True)
    ]
    sentence = listed(parts) if parts else "did not move"
    return Change(group="camera", subject="camera", sentence=sentence, values=values)


def _length(centimetres: float | None) -> tuple[str, float]:
    return ("scene units", 1.0) if centimetres is None else ("cm", centimetres)


def _value(name: str, unit: str, before: float, after: float) -> ChangedValue:
    return ChangedValue(name=name, unit=unit, before=float(before), after=float(after))
