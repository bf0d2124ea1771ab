"""Generates CLEVR-style scenes from a seed, and checks the places of objects in scenes of others.

A scene is chosen object by object and drawn as numbers, by closed-form ray casting, to count the pixels in which each
is seen. The solids are the ideal ones, and one ray goes through the centre of each pixel. No graphics driver takes
part, so that the same seed gives the same scenes on every machine.

Scenes of others may have objects anywhere, and so may scenes that an attack has changed. The checks (on the plane,
apart from each other, inside the frame) are exact for the ideal solids, which all are upright.
"""

from collections.abc import Sequence
from math import ceil, cos, floor, hypot, radians, sin, sqrt
from random import Random

import numpy as np
from numpy.typing import NDArray

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.mesh import Doubles
from scene_attack_questions.clevr.records import (
    ATTRIBUTES,
    FOCAL_LENGTH,
    IMAGE_SIZE,
    RADIUS,
    CameraRecord,
    LightsRecord,
    ObjectRecord,
    Rig,
    SceneRecord,
    Vector,
    Viewpoint,
    bounding_radius,
    directions,
    half_height,
    jittered,
    relationships,
)

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


def place(count: int, rig: Rig, random: Random) -> list[ObjectRecord]:
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


def _attempt(
    count: int, viewpoint: Viewpoint, axes: tuple[Vector, Vector], random: Random
) -> list[ObjectRecord] | None:
    objects: list[ObjectRecord] = []
    for _ in range(count):
        size, color, material, shape = (random.choice(values) for values in ATTRIBUTES.values())
        for _ in range(TRIES):
            centre = (random.uniform(-REACH, REACH), random.uniform(-REACH, REACH), half_height(shape, size))
            if _is_free(centre, size, objects, axes) and viewpoint.frames(centre, bounding_radius(shape, size)):
                break
        else:
            return None
        attributes = {"shape": shape, "size": size, "color": color, "material": material}
        seen = {"coords_3d": centre, "rotation": random.uniform(0, 360), "pixel_coords": viewpoint.pixel(centre)}
        objects.append(ObjectRecord.model_validate(attributes | seen))
    return objects


def _is_free(centre: Vector, size: str, objects: list[ObjectRecord], axes: tuple[Vector, Vector]) -> bool:
    for other in objects:
        x, y = centre[0] - other.coords_3d[0], centre[1] - other.coords_3d[1]
        if hypot(x, y) - RADIUS[size] - RADIUS[other.size] < MIN_GAP:
            return False
        if any(abs(x * axis[0] + y * axis[1]) < MARGIN for axis in axes):
            return False
    return True


def visible_pixels(placed: Sequence[ObjectRecord], rig: Rig) -> list[int]:
    """Returns the number of pixels of each object in `object_numbers`."""
    numbers = object_numbers(placed, rig)
    return [int((numbers == k).sum()) for k in range(len(placed))]


def object_numbers(placed: Sequence[ObjectRecord], rig: Rig) -> NDArray[np.int64]:
    """Returns the index of the object that each pixel shows, −1 where there is none, [240, 320].

    The plane hides nothing, as all objects stand on it.
    """
    numbers = np.full(IMAGE_SIZE, -1, np.int64)
    nearest = np.full(IMAGE_SIZE, np.inf)
    viewpoint = Viewpoint(rig)
    for k, thing in enumerate(placed):
        box = _box(thing, viewpoint)
        depth = _depth(thing, rig, _rays(box, viewpoint))
        closer = depth < nearest[box]
        nearest[box] = np.where(closer, depth, nearest[box])
        numbers[box] = np.where(closer, k, numbers[box])
    return numbers


def _box(thing: ObjectRecord, viewpoint: Viewpoint) -> tuple[slice, slice]:
    """Returns rows and columns outside of which nothing of an object is seen."""
    radius = bounding_radius(thing.shape, thing.size)
    right, up, depth = viewpoint.in_camera(thing.coords_3d)

    def limits(offset: float, pixels: int, focal: float) -> slice:
        # Tangents of the two planes through the eye that touch the bounding sphere.
        square = depth * depth - radius * radius
        spread = radius * sqrt(max(0.0, offset * offset + square))
        low, high = (offset * depth - spread) / square, (offset * depth + spread) / square
        first, last = floor(pixels / 2 + focal * low), ceil(pixels / 2 + focal * high)
        return slice(max(0, first), max(0, min(pixels, last)))

    height, width = IMAGE_SIZE
    focal = FOCAL_LENGTH * width
    return limits(-up, height, focal), limits(right, width, focal)


def _rays(box: tuple[slice, slice], viewpoint: Viewpoint) -> Doubles:
    """Returns the directions through the centres of a box's pixels [3, rows, columns], of length 1 along the view."""
    height, width = IMAGE_SIZE
    focal = FOCAL_LENGTH * width
    rows, columns = (np.arange(part.start, part.stop) + 0.5 for part in box)
    right, up, behind = (np.array(axis)[:, None, None] for axis in (viewpoint.right, viewpoint.up, viewpoint.behind))
    rays: Doubles = behind + right * ((columns - width / 2) / focal) + up * ((height / 2 - rows) / focal)[:, None]
    return rays


def _depth(thing: ObjectRecord, rig: Rig, rays: Doubles) -> Doubles:
    """Returns the distance along the view at which each ray enters an object; infinity where it misses it."""
    angle = radians(thing.rotation)
    eye = np.subtract(rig.camera, thing.coords_3d)
    x, y = rays[0] * cos(angle) + rays[1] * sin(angle), rays[1] * cos(angle) - rays[0] * sin(angle)
    start = np.array([eye[0] * cos(angle) + eye[1] * sin(angle), eye[1] * cos(angle) - eye[0] * sin(angle), eye[2]])
    if thing.shape == "sphere":
        return _between(*_quadric(start, (x, y, rays[2]), RADIUS[thing.size]))
    top = _slab(start[2], rays[2], half_height(thing.shape, thing.size))
    if thing.shape == "cylinder":
        return _between(*_overlap(_quadric(start[:2], (x, y), RADIUS[thing.size]), top))
    half = half_height(thing.shape, thing.size)
    return _between(*_overlap(_overlap(_slab(start[0], x, half), _slab(start[1], y, half)), top))


Interval = tuple[Doubles, Doubles]
"""Distances at which each ray enters and leaves; the ray misses where the first is above the second."""


def _quadric(start: Doubles, rays: Sequence[Doubles], radius: float) -> Interval:
    """A sphere, or an endless cylinder about +z if only x and y are given."""
    a = sum(ray * ray for ray in rays)
    b = sum(ray * at for ray, at in zip(rays, start, strict=True))
    inside = b * b - a * (float(start @ start) - radius * radius)
    root = np.sqrt(np.maximum(inside, 0.0))
    return np.where(inside >= 0, (-b - root) / a, np.inf), np.where(inside >= 0, (-b + root) / a, -np.inf)


def _slab(start: float, ray: Doubles, half: float) -> Interval:
    with np.errstate(divide="ignore"):
        lower, upper = (-half - start) / ray, (half - start) / ray
    return np.minimum(lower, upper), np.maximum(lower, upper)


def _overlap(first: Interval, second: Interval) -> Interval:
    return np.maximum(first[0], second[0]), np.minimum(first[1], second[1])


def _between(enter: Doubles, leave: Doubles) -> Doubles:
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


MIN_OBJECTS, MAX_OBJECTS = 3, 10
MIN_PIXELS = 200
"""Smallest number of pixels, of 240×320, in which each object must be seen."""

DISCARDS = 1000
"""Scenes discarded for a hidden object before `generate` gives up."""


def generate(
    seed: int,
    index: int,
    *,
    objects: tuple[int, int] = (MIN_OBJECTS, MAX_OBJECTS),
    split: str = "new",
) -> SceneRecord:
    """Returns the scene of that index: it depends on the arguments alone, not on the scenes before it.

    The number of objects is uniform within `objects`, both bounds included. A scene in which an object is seen in fewer
    than MIN_PIXELS pixels is discarded, and the objects are placed anew under the same camera and lights. Raises
    InvalidRequest("objects") if so many do not fit.
    """
    random = Random(f"clevr/{seed}/{split}/{index}")
    count = random.randint(*objects)
    rig = jittered(random)
    for _ in range(DISCARDS):
        placed = place(count, rig, random)
        if min(visible_pixels(placed, rig)) >= MIN_PIXELS:
            return record_of(placed, rig, split, index)
    raise InvalidRequest("objects", f"{count} objects cannot all be seen in {MIN_PIXELS} pixels each")


def record_of(placed: Sequence[ObjectRecord], rig: Rig, split: str = "new", index: int = 0) -> SceneRecord:
    """Returns the record of placed objects under a camera and lights, with the directions and relations they have."""
    along = directions(rig)
    return SceneRecord.model_validate(
        {
            "split": split,
            "image_index": index,
            "image_filename": f"CLEVR_{split}_{index:06d}.png",
            "objects": placed,
            "relationships": relationships([thing.coords_3d for thing in placed], along),
            "directions": along,
            "camera": CameraRecord(position=rig.camera),
            "lights": LightsRecord(key=rig.key, fill=rig.fill, back=rig.back),
        }
    )


CONTACT = 0.01
"""Largest distance of an object's lowest point from the plane at which it stands on it."""


def check(placed: Sequence[ObjectRecord], rig: Rig) -> None:
    """Checks that all objects stand on the plane, are inside the frame, and do not overlap.

    Raises InvalidRequest, which names the first object that does not ("objects.2").
    """
    viewpoint = Viewpoint(rig)
    for k, thing in enumerate(placed):
        height = thing.coords_3d[2] - half_height(thing.shape, thing.size)
        if abs(height) > CONTACT:
            how = "floats above" if height > 0 else "sinks into"
            raise InvalidRequest(f"objects.{k}", f"it {how} the plane by {abs(height):.3g}")
        if not viewpoint.frames(thing.coords_3d, bounding_radius(thing.shape, thing.size)):
            raise InvalidRequest(f"objects.{k}", "it is not inside the frame as a whole")
        for j, other in enumerate(placed[:k]):
            if overlap(thing, other):
                raise InvalidRequest(f"objects.{k}", f"it overlaps object {j}")


def overlap(first: ObjectRecord, second: ObjectRecord) -> bool:
    """Returns whether two objects have more than their surfaces in common."""
    if first.shape == "sphere" or (first.shape == "cylinder" and second.shape == "cube"):
        first, second = second, first
    # Now `second` is the rounder one: it is a sphere if any is, and a cylinder beside a cube.
    x, y = _turned(first, second.coords_3d[0] - first.coords_3d[0], second.coords_3d[1] - first.coords_3d[1])
    z = second.coords_3d[2] - first.coords_3d[2]
    reach = RADIUS[second.size]
    if first.shape == "sphere":
        return hypot(x, y, z) < RADIUS[first.size] + reach
    half = half_height(first.shape, first.size)
    if first.shape == "cylinder":
        aside = max(0.0, hypot(x, y) - RADIUS[first.size])
    else:
        aside = hypot(max(0.0, abs(x) - half), max(0.0, abs(y) - half))
    if second.shape == "sphere":
        return hypot(aside, max(0.0, abs(z) - half)) < reach
    if abs(z) >= half + half_height(second.shape, second.size):
        return False
    return aside < reach if second.shape == "cylinder" else not (_separated(first, second) or _separated(second, first))


def _turned(thing: ObjectRecord, x: float, y: float) -> tuple[float, float]:
    """Returns a vector in the plane along an object's own axes."""
    angle = radians(thing.rotation)
    return x * cos(angle) + y * sin(angle), y * cos(angle) - x * sin(angle)


def _separated(first: ObjectRecord, second: ObjectRecord) -> bool:
    """Returns whether a side of the first cube's base separates it from the second's."""
    x, y = _turned(first, second.coords_3d[0] - first.coords_3d[0], second.coords_3d[1] - first.coords_3d[1])
    angle = radians(second.rotation - first.rotation)
    half = half_height(first.shape, first.size)
    reach = half_height(second.shape, second.size) * (abs(cos(angle)) + abs(sin(angle)))
    return max(abs(x), abs(y)) >= half + reach
