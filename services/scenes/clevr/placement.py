"""Checks where objects are: on the plane, apart from each other, and inside the frame.

Scenes of others may have objects anywhere, and so may scenes that an attack has changed. The checks are exact for the
ideal solids, which all are upright.
"""

from collections.abc import Sequence
from math import cos, hypot, radians, sin

from services.errors import InvalidRequest
from services.scenes.clevr.attributes import RADIUS, bounding_radius, half_height
from services.scenes.clevr.layout import Placed
from services.scenes.clevr.records import SceneRecord
from services.scenes.clevr.rig import Rig, Viewpoint

CONTACT = 0.01
"""Largest distance of an object's lowest point from the plane at which it stands on it."""


def placed_in(record: SceneRecord) -> list[Placed]:
    """Returns the objects of a record."""
    return [Placed(o.shape, o.size, o.color, o.material, o.coords_3d, o.rotation) for o in record.objects]


def check(placed: Sequence[Placed], rig: Rig) -> None:
    """Checks that all objects stand on the plane, are inside the frame, and do not overlap.

    Raises InvalidRequest, which names the first object that does not ("objects.2").
    """
    viewpoint = Viewpoint(rig)
    for k, one in enumerate(placed):
        height = one.centre[2] - half_height(one.shape, one.size)
        if abs(height) > CONTACT:
            how = "floats above" if height > 0 else "sinks into"
            raise InvalidRequest(f"objects.{k}", f"it {how} the plane by {abs(height):.3g}")
        if not viewpoint.frames(one.centre, bounding_radius(one.shape, one.size)):
            raise InvalidRequest(f"objects.{k}", "it is not inside the frame as a whole")
        for j, other in enumerate(placed[:k]):
            if overlap(one, other):
                raise InvalidRequest(f"objects.{k}", f"it overlaps object {j}")


def overlap(one: Placed, other: Placed) -> bool:
    """Returns whether two objects have more than their surfaces in common."""
    if one.shape == "sphere" or (one.shape == "cylinder" and other.shape == "cube"):
        one, other = other, one
    # Now `other` is the rounder one: it is a sphere if any is, and a cylinder beside a cube.
    x, y = _turned(one, other.centre[0] - one.centre[0], other.centre[1] - one.centre[1])
    z = other.centre[2] - one.centre[2]
    reach = RADIUS[other.size]
    if one.shape == "sphere":
        return hypot(x, y, z) < RADIUS[one.size] + reach
    half = half_height(one.shape, one.size)
    if one.shape == "cylinder":
        aside = max(0.0, hypot(x, y) - RADIUS[one.size])
    else:
        aside = hypot(max(0.0, abs(x) - half), max(0.0, abs(y) - half))
    if other.shape == "sphere":
        return hypot(aside, max(0.0, abs(z) - half)) < reach
    if abs(z) >= half + half_height(other.shape, other.size):
        return False
    return aside < reach if other.shape == "cylinder" else not (_separated(one, other) or _separated(other, one))


def _turned(one: Placed, x: float, y: float) -> tuple[float, float]:
    """Returns a vector in the plane along an object's own axes."""
    angle = radians(one.rotation)
    return x * cos(angle) + y * sin(angle), y * cos(angle) - x * sin(angle)


def _separated(one: Placed, other: Placed) -> bool:
    """Returns whether a side of the first cube's base separates it from the second's."""
    x, y = _turned(one, other.centre[0] - one.centre[0], other.centre[1] - one.centre[1])
    angle = radians(other.rotation - one.rotation)
    half = half_height(one.shape, one.size)
    reach = half_height(other.shape, other.size) * (abs(cos(angle)) + abs(sin(angle)))
    return max(abs(x), abs(y)) >= half + reach
