"""Perturbations of the pyrender renderer's groups: in degrees, centimetres and percent, and in sentences: "moved 4.2 cm
right", "turned 6.5°", "23 % dimmer".

Right, left, up and down are those of the unperturbed image; towards and away are along the camera's line of sight.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import degrees

import numpy as np
from torch import Tensor

from scene_attack.rendering.physical_change import Change, ChangedValue, PhysicalChange, Worded, listed, number, signed
from scene_attack.rendering.pose import Length, angle_of, changed, distance_of, lengths, move, poses
from scene_attack.rendering.protocol import Renderer
from scene_attack.rendering.pyrender.parameters import ENERGY, IRRADIANCE
from scene_attack.scenes.description import object_names
from scene_attack.scenes.mesh import Doubles
from scene_attack.scenes.resolve import ResolvedScene

CHANNELS = ("red", "green", "blue")
LAMPS = {"point": "lamp", "directional": "distant lamp", "spot": "spotlight"}
FACTORS = {"point": ENERGY, "spot": ENERGY, "directional": IRRADIANCE}
"""Energy of a light whose coordinate is 1."""


def worded(scene: ResolvedScene, renderer: Renderer, perturbation: Mapping[str, Tensor]) -> list[Worded]:
    """A perturbation of the renderer's initial values in words, by group and by object or light.

    For units of length see `pose.lengths`.
    """
    names, axes, (_, around) = object_names(scene.description, scene.titles), scene.view[:3, :3].T, lengths(scene)
    result: list[Worded] = []
    for group, moved in perturbation.items():
        initial, change = renderer.initial()[group].double().numpy(), moved.double().numpy()
        if group == "illumination":
            result += lights(renderer.names(group) or [], initial, change, around, axes)
        elif group == "color":
            result += [color(name, k, initial[k], change[k]) for k, name in enumerate(names)]
        else:
            result += poses(scene, group, initial, change)
    return result


def color(subject: str, index: int, initial: Doubles, change: Doubles) -> Worded:
    """A change of an object's linear colour factors [3], each in percent of what it was; its size is that of the
    channel that changes most, in percent of the full range."""
    thing = f"object {index}"
    words = [
        f"{channel} {signed(100 * change[k] / initial[k])} %" if initial[k] else f"{channel} from 0 to {change[k]:.3g}"
        for k, channel in enumerate(CHANNELS)
    ]
    values = [
        changed(f"{thing} color {channel}", "linear factor", initial[k], change[k])
        for k, channel in enumerate(CHANNELS)
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
        values = [changed(names[energy], unit, initial[energy], change[energy], FACTORS.get(kind, 1.0))]
        sizes = []
        if initial[energy] > 0:
            percent = 100 * float(change[energy] / initial[energy])
            sizes.append(PhysicalChange(group=group, subject=names[energy], measure="change", value=percent, unit="%"))
        direction = [i for i in at if " direction " in names[i]]
        if position := [i for i in at if i not in direction]:
            parts.append(move(change[position], length, axes))
            values += [changed(names[i], length.unit, initial[i], change[i], length.scale) for i in position]
            sizes.append(distance_of(group, light, change[position], length))
        if direction:
            old, new = initial[direction], initial[direction] + change[direction]
            angle = float(np.arctan2(np.linalg.norm(np.cross(old, new)), old @ new))
            parts.append(f"its direction turned {number(degrees(angle))}°")
            after = new / (np.linalg.norm(new) or 1.0)
            values += [
                ChangedValue(name=names[i], unit="unit vector", before=float(old[k]), after=float(after[k]))
                for k, i in enumerate(direction)
            ]
            sizes.append(angle_of(group, f"{light} direction", angle))
        yield Worded(Change(group=group, subject=subject, sentence=listed(parts), values=values), sizes)


def brightness(initial: float, change: float) -> str:
    """A change of a light's radiance or energy, e.g. "23 % dimmer"."""
    if initial == 0:
        return "is no longer dark" if change else "is dark as before"
    percent = 100 * change / initial
    if percent == 0:
        return "as bright as before"
    return f"{number(abs(percent))} % {'brighter' if percent > 0 else 'dimmer'}"
