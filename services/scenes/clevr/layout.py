"""Chooses the objects of a scene and their places on the plane."""

from dataclasses import dataclass
from math import hypot
from random import Random

from services.errors import InvalidRequest
from services.scenes.clevr.attributes import ATTRIBUTES, RADIUS, bounding_radius, half_height
from services.scenes.clevr.relations import directions
from services.scenes.clevr.rig import Rig, Vector, Viewpoint

REACH = 3.0
"""Largest absolute x and y of an object's centre."""
MIN_GAP = 0.25
"""Smallest distance between the circles of two objects in the plane."""
MARGIN = 0.4
"""Smallest distance of two centres along each relation's direction, so that every pair is clearly related."""
TRIES = 50
"""Places tried for an object before all objects are placed anew."""
RESTARTS = 1000
"""Times that the objects are placed anew before `place` gives up."""


@dataclass(frozen=True)
class Placed:
    """An object on the plane. `rotation` is its turn about +z in degrees."""

    shape: str
    size: str
    color: str
    material: str
    centre: Vector
    rotation: float


def place(count: int, rig: Rig, random: Random) -> list[Placed]:
    """Returns `count` objects of random attributes that keep MIN_GAP and MARGIN and are inside the frame as a whole.

    Raises InvalidRequest("objects") if so many do not fit.
    """
    viewpoint = Viewpoint(rig)
    along = directions(rig)
    for _ in range(RESTARTS):
        objects = _attempt(count, viewpoint, (along["right"], along["behind"]), random)
        if objects is not None:
            return objects
    raise InvalidRequest("objects", f"{count} objects do not fit on the plane with their margins")


def _attempt(count: int, viewpoint: Viewpoint, axes: tuple[Vector, Vector], random: Random) -> list[Placed] | None:
    objects: list[Placed] = []
    for _ in range(count):
        size, color, material, shape = (random.choice(values) for values in ATTRIBUTES.values())
        for _ in range(TRIES):
            centre = (random.uniform(-REACH, REACH), random.uniform(-REACH, REACH), half_height(shape, size))
            if _is_free(centre, size, objects, axes) and viewpoint.frames(centre, bounding_radius(shape, size)):
                break
        else:
            return None
        objects.append(Placed(shape, size, color, material, centre, random.uniform(0, 360)))
    return objects


def _is_free(centre: Vector, size: str, objects: list[Placed], axes: tuple[Vector, Vector]) -> bool:
    for other in objects:
        x, y = centre[0] - other.centre[0], centre[1] - other.centre[1]
        if hypot(x, y) - RADIUS[size] - RADIUS[other.size] < MIN_GAP:
            return False
        if any(abs(x * axis[0] + y * axis[1]) < MARGIN for axis in axes):
            return False
    return True
