"""The poses of objects and the camera as parameters, which renderers share: the camera's coordinates and their
bounds, and changes in words: "moved 4.2 cm right", "turned 6.5°".

Right, left, up and down are those of the unperturbed image; towards and away are along the camera's line of sight.
"""

from math import asin, degrees, inf, isclose, pi
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene_attack.rendering.opengl.camera import CameraMatrices
from scene_attack.rendering.physical_change import Change, ChangedValue, PhysicalChange, Worded, listed, number
from scene_attack.rendering.variation import Variation
from scene_attack.scenes.description import SceneObject, object_names
from scene_attack.scenes.mesh import FIT_RADIUS, Doubles
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.view import NEAR, camera_pose, rotation_matrix

POLES = 0.05
"""Smallest angle between the camera and a pole, radians, unless the scene's own camera is nearer. At a pole azimuth and
roll are the same turn."""


class MovingCamera:
    """The scene's camera as a function of four coordinates: azimuth, elevation, distance and roll as in the scene's
    description. The lens is the scene's.

    initial: float64 [4]. bounds: lowest and highest value of each coordinate, float64 [4]. Azimuth and roll are free.
    The elevation keeps `POLES` from straight above and below. The distance keeps the camera outside the ball about the
    origin that holds all objects where the scene has them, and all that is in the scene before the far plane. Over a
    floor it stays above the floor's plane. A scene whose own camera is beyond such a limit
    has its own value for a limit.
    """

    def __init__(self, scene: ResolvedScene) -> None:
        self._projection = scene.projection
        camera = scene.description.camera
        own = torch.tensor([camera.azimuth, camera.elevation, camera.distance, camera.roll], dtype=torch.float64)
        objects, fixed = scene.description.objects, scene.description.fixed
        radius = max(map(_reach, objects))
        far = scene.projection[2, 3] / (scene.projection[2, 2] + 1)
        steepest, nearest, furthest = pi / 2 - POLES, radius + NEAR, far - max(map(_reach, (*objects, *fixed)))
        lowest, floor = -steepest, scene.description.floor
        if floor is not None:
            furthest = min(furthest, far - float(np.linalg.norm((floor.size / 2, floor.height, floor.size / 2))))
            lowest = asin(min(1.0, max(floor.height / nearest, floor.height / furthest)))
        limits = torch.tensor([[-inf, lowest, nearest, -inf], [inf, steepest, furthest, inf]]).double()
        self.initial = own
        self.bounds: tuple[Tensor, Tensor] = (torch.minimum(limits[0], own), torch.maximum(limits[1], own))

    def matrices(self, camera: NDArray[np.float64]) -> CameraMatrices:
        """The camera at coordinates [4]. Positive roll turns it to its own left, so that its image turns to the right
        (clockwise).
        """
        return CameraMatrices.of(camera_pose(*(float(x) for x in camera)), self._projection)


def _reach(thing: SceneObject) -> float:
    """The radius of the ball about the origin that holds a thing."""
    return float(np.linalg.norm(thing.translation)) + thing.scale * FIT_RADIUS


def seen_from(camera: Tensor, variation: Variation) -> Tensor:
    """Coordinates [..., 4] of a camera under a variation of its view."""
    turned = torch.tensor([variation.azimuth, variation.elevation, 0.0, variation.roll], dtype=camera.dtype)
    return camera * torch.tensor([1.0, 1.0, variation.distance, 1.0], dtype=camera.dtype) + turned


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


def lengths(scene: ResolvedScene) -> tuple[list[Length], Length]:
    """The unit of length of each object, and that of lights and camera.

    It is the centimetre where the mesh's real size is known, else the scene unit. Several objects of a library are each
    of another scale, so that it is not known for lights and camera; those of one file have the file's scale.
    """
    own = [
        Length() if mesh.centimetres is None else Length("cm", mesh.centimetres / placed.scale)
        for mesh, placed in zip(scene.meshes, scene.description.objects, strict=True)
    ]
    same = all(one.unit == own[0].unit and isclose(one.scale, own[0].scale, rel_tol=1e-6) for one in own)
    return own, own[0] if same else Length()


def poses(scene: ResolvedScene, group: str, initial: Doubles, change: Doubles) -> list[Worded]:
    """A change of `translation` or `rotation` [objects, 3], by object, or of `camera` [4], in words."""
    (own, around), axes = lengths(scene), scene.view[:3, :3].T
    if group == "camera":
        return [camera(initial, change, around)]
    names = object_names(scene.description, scene.titles)
    if group == "translation":
        return [translation(name, k, initial[k], change[k], own[k], axes) for k, name in enumerate(names)]
    return [rotation(name, k, initial[k], change[k], axes) for k, name in enumerate(names)]


def translation(subject: str, index: int, initial: Doubles, change: Doubles, length: Length, axes: Doubles) -> Worded:
    """An object's move by `change` [3] in scene units; rows of `axes` [3, 3] are the camera's right, up and back."""
    thing = f"object {index}"
    values = [
        changed(f"{thing} translation {axis}", length.unit, initial[k], change[k], length.scale)
        for k, axis in enumerate("xyz")
    ]
    sentence = move(change, length, axes)
    return Worded(
        Change(group="translation", subject=subject, sentence=sentence, values=values),
        [distance_of("translation", thing, change, length)],
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
        changed(f"{thing} rotation {axis}", "degrees", initial[k], change[k], degrees(1))
        for k, axis in enumerate("xyz")
    ]
    sentence = "did not turn" if angle == 0 else turned(angle, twice / (sine or 1.0), axes)
    return Worded(
        Change(group="rotation", subject=subject, sentence=sentence, values=values),
        [angle_of("rotation", thing, angle)],
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
        changed(f"camera {label}", unit.unit, old, by, unit.scale)
        for (label, unit), old, by in zip(units.items(), initial, change, strict=True)
    ]
    sentence = listed(parts) if parts else "did not move"
    return Worded(
        Change(group="camera", subject="camera", sentence=sentence, values=values),
        [
            angle_of("camera", "azimuth", change[0]),
            angle_of("camera", "elevation", change[1]),
            angle_of("camera", "roll", change[3]),
            distance_of("camera", "camera", change[2:3], length),
        ],
    )


def angle_of(group: str, subject: str, radians: float) -> PhysicalChange:
    """The size of a turn by an angle in radians."""
    return PhysicalChange(group=group, subject=subject, measure="angle", value=degrees(radians), unit="degrees")


def distance_of(group: str, subject: str, change: Doubles, length: Length) -> PhysicalChange:
    """The size of a movement by a vector of scene units."""
    value = float(np.linalg.norm(change)) * length.scale
    return PhysicalChange(group=group, subject=subject, measure="distance", value=value, unit=length.unit)


def changed(name: str, unit: str, before: float, change: float, scale: float = 1.0) -> ChangedValue:
    """A value before and after a change."""
    return ChangedValue(name=name, unit=unit, before=float(scale * before), after=float(scale * (before + change)))
