"""Perturbations of the pyrender renderer's groups: in degrees, centimetres and percent, and in sentences: "moved 4.2 cm
right", "turned 6.5°", "23 % dimmer".

Right, left, up and down are those of the unperturbed image; towards and away are along the camera's line of sight.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import degrees
from typing import NamedTuple

import numpy as np
from torch import Tensor

from scene_attack.rendering.physical_change import Change, ChangedValue, PhysicalChange, Worded, listed, number, signed
from scene_attack.rendering.protocol import Renderer
from scene_attack.rendering.pyrender.parameters import ENERGY, IRRADIANCE
from scene_attack.scenes.description import object_names
from scene_attack.scenes.mesh import Doubles
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.view import rotation_matrix

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


class Length(NamedTuple):
    """A unit of length, and its number in a scene unit."""

    unit: str = "scene units"
    scale: float = 1.0


def worded(scene: ResolvedScene, renderer: Renderer, perturbation: Mapping[str, Tensor]) -> list[Worded]:
    """A perturbation of the renderer's initial values in words, by group and by object or light.

    Lengths are in centimetres where the meshes' real size is known, and in scene units otherwise. With several objects
    that is known for each object, but not for lights and camera, since every mesh is scaled to the same size.
    """
    lengths = [
        Length() if mesh.centimetres is None else Length("cm", mesh.centimetres / placed.scale)
        for mesh, placed in zip(scene.meshes, scene.description.objects, strict=True)
    ]
    around = lengths[0] if len(lengths) == 1 else Length()
    names, axes = object_names(scene.description, scene.titles), scene.view[:3, :3].T
    result: list[Worded] = []
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


def translation(subject: str, index: int, initial: Doubles, change: Doubles, length: Length, axes: Doubles) -> Worded:
    """An object's move by `change` [3] in scene units; rows of `axes` [3, 3] are the camera's right, up and back."""
    thing = f"object {index}"
    values = [
        _value(f"{thing} translation {axis}", length.unit, initial[k], change[k], length.scale)
        for k, axis in enumerate("xyz")
    ]
    sentence = move(change, length, axes)
    return Worded(
        Change(group="translation", subject=subject, sentence=sentence, values=values),
        [_distance("translation", thing, change, length)],
    )


def move(change: Doubles, length: Length, axes: Doubles) -> str:
    """A movement by a vector [3] of scene units in words, e.g. "moved 4.2 cm right and 1.1 cm up"."""
    along = axes @ change * length.scale
    size = float(np.linalg.norm(along))
    if size == 0:
        return "did not move"
    words = [
        f"{number(abs(value))} {length.unit} {words[int(value > 0)]}"
        for value, words in zip(along, DIRECTIONS, strict=True)
        if abs(value) >= SMALL * size
    ]
    return "moved " + listed(words)


def rotation(subject: str, index: int, initial: Doubles, change: Doubles, axes: Doubles) -> Worded:
    """An object's turn from its own pose, given rotation vectors [3]."""
    turn = rotation_matrix(initial + change) @ rotation_matrix(initial).T
    # the axis times twice the sine of the angle; with the trace it gives the angle precisely at any size
    twice = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(twice))
    angle = float(np.arctan2(sine, float(np.trace(turn)) - 1))
    thing = f"object {index}"
    values = [
        _value(f"{thing} rotation {axis}", "degrees", initial[k], change[k], degrees(1)) for k, axis in enumerate("xyz")
    ]
    sentence = "did not turn" if angle == 0 else turned(angle, twice / (sine or 1.0), axes)
    return Worded(
        Change(group="rotation", subject=subject, sentence=sentence, values=values), [_angle("rotation", thing, angle)]
    )


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


def color(subject: str, index: int, initial: Doubles, change: Doubles) -> Worded:
    """A change of an object's linear colour factors [3], each in percent of what it was; its size is that of the
    channel that changes most, in percent of the full range."""
    thing = f"object {index}"
    words = [
        f"{channel} {signed(100 * change[k] / initial[k])} %" if initial[k] else f"{channel} from 0 to {change[k]:.3g}"
        for k, channel in enumerate(CHANNELS)
    ]
    values = [
        _value(f"{thing} color {channel}", "linear factor", initial[k], change[k]) for k, channel in enumerate(CHANNELS)
    ]
    sentence = ", ".join(words) if change.any() else "has its colour as before"
    percent = 100 * float(change[np.abs(change).argmax()])
    size = PhysicalChange(
        group="color", subject=thing, measure="largest channel", value=percent, unit="% of full range"
    )
    return Worded(Change(group="color", subject=subject, sentence=sentence, values=values), [size])


def lights(names: Sequence[str], initial: Doubles, change: Doubles, length: Length, axes: Doubles) -> Iterator[Worded]:
    """Changes of the group `illumination`, whose coordinates [n] have these names ("point 0 energy"), by light.

    An energy that was 0 has no change in percent.
    """
    group = "illumination"
    places: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        places.setdefault(" ".join(name.split()[:2]), []).append(index)
    kinds = Counter(light.split()[0] for light in places)
    for light, (energy, *at) in places.items():
        kind, _, which = light.partition(" ")
        lamp = LAMPS.get(kind)
        subject = "ambient light" if lamp is None else lamp if kinds[kind] == 1 else f"{lamp} {which}"
        unit = "radiance" if lamp is None else "energy"
        parts = [brightness(initial[energy], change[energy])]
        values = [_value(names[energy], unit, initial[energy], change[energy], FACTORS.get(kind, 1.0))]
        sizes = []
        if initial[energy] > 0:
            percent = 100 * float(change[energy] / initial[energy])
            sizes.append(PhysicalChange(group=group, subject=names[energy], measure="change", value=percent, unit="%"))
        direction = [i for i in at if " direction " in names[i]]
        if position := [i for i in at if i not in direction]:
            parts.append(move(change[position], length, axes))
            values += [_value(names[i], length.unit, initial[i], change[i], length.scale) for i in position]
            sizes.append(_distance(group, light, change[position], length))
        if direction:
            old, new = initial[direction], initial[direction] + change[direction]
            angle = float(np.arctan2(np.linalg.norm(np.cross(old, new)), old @ new))
            parts.append(f"its direction turned {number(degrees(angle))}°")
            after = new / (np.linalg.norm(new) or 1.0)
            values += [
                ChangedValue(name=names[i], unit="unit vector", before=float(old[k]), after=float(after[k]))
                for k, i in enumerate(direction)
            ]
            sizes.append(_angle(group, f"{light} direction", angle))
        yield Worded(Change(group=group, subject=subject, sentence=listed(parts), values=values), sizes)


def brightness(initial: float, change: float) -> str:
    """A change of a light's radiance or energy, e.g. "23 % dimmer"."""
    if initial == 0:
        return "is no longer dark" if change else "is dark as before"
    percent = 100 * change / initial
    if percent == 0:
        return "as bright as before"
    return f"{number(abs(percent))} % {'brighter' if percent > 0 else 'dimmer'}"


def camera(initial: Doubles, change: Doubles, length: Length) -> Worded:
    """A change of the camera's azimuth, elevation, distance and roll [4]."""
    words = [
        (degrees(change[0]), "°", ("left", "right"), " around the scene"),
        (degrees(change[1]), "°", ("down", "up"), " around the scene"),
        (change[2] * length.scale, f" {length.unit}", ("nearer", "farther"), ""),
    ]
    moves = [f"{number(abs(size))}{of} {pair[int(size > 0)]}{around}" for size, of, pair, around in words if size]
    parts = ["moved " + listed(moves)] if moves else []
    if change[3]:
        parts.append(f"rolled {number(abs(degrees(change[3])))}° to its {'left' if change[3] > 0 else 'right'}")
    angle = Length("degrees", degrees(1))
    units = {"azimuth": angle, "elevation": angle, "distance": length, "roll": angle}
    values = [
        _value(f"camera {label}", unit.unit, old, by, unit.scale)
        for (label, unit), old, by in zip(units.items(), initial, change, strict=True)
    ]
    sentence = listed(parts) if parts else "did not move"
    return Worded(
        Change(group="camera", subject="camera", sentence=sentence, values=values),
        [
            _angle("camera", "azimuth", change[0]),
            _angle("camera", "elevation", change[1]),
            _angle("camera", "roll", change[3]),
            _distance("camera", "camera", change[2:3], length),
        ],
    )


def _angle(group: str, subject: str, radians: float) -> PhysicalChange:
    return PhysicalChange(group=group, subject=subject, measure="angle", value=degrees(radians), unit="degrees")


def _distance(group: str, subject: str, change: Doubles, length: Length) -> PhysicalChange:
    value = float(np.linalg.norm(change)) * length.scale
    return PhysicalChange(group=group, subject=subject, measure="distance", value=value, unit=length.unit)


def _value(name: str, unit: str, before: float, change: float, scale: float = 1.0) -> ChangedValue:
    return ChangedValue(name=name, unit=unit, before=float(scale * before), after=float(scale * (before + change)))
