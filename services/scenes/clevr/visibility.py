"""Draws the numbers of a scene's objects by closed-form ray casting, to count the pixels in which each is seen.

The solids are the ideal ones, and one ray goes through the centre of each pixel. No graphics driver takes part, so that
the same seed gives the same scenes on every machine.
"""

from collections.abc import Sequence
from math import ceil, cos, floor, radians, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from services.scenes.clevr.attributes import RADIUS, bounding_radius, half_height
from services.scenes.clevr.layout import Placed
from services.scenes.clevr.rig import FOCAL_LENGTH, IMAGE_SIZE, Rig, Viewpoint

Doubles = NDArray[np.float64]


def visible_pixels(placed: Sequence[Placed], rig: Rig) -> list[int]:
    """Returns the number of pixels of each object in `object_numbers`."""
    numbers = object_numbers(placed, rig)
    return [int((numbers == k).sum()) for k in range(len(placed))]


def object_numbers(placed: Sequence[Placed], rig: Rig) -> NDArray[np.int64]:
    """Returns the index of the object that each pixel shows, −1 where there is none, [240, 320].

    The plane hides nothing, as all objects stand on it.
    """
    numbers = np.full(IMAGE_SIZE, -1, np.int64)
    nearest = np.full(IMAGE_SIZE, np.inf)
    viewpoint = Viewpoint(rig)
    for k, one in enumerate(placed):
        box = _box(one, viewpoint)
        depth = _depth(one, rig, _rays(box, viewpoint))
        closer = depth < nearest[box]
        nearest[box] = np.where(closer, depth, nearest[box])
        numbers[box] = np.where(closer, k, numbers[box])
    return numbers


def _box(one: Placed, viewpoint: Viewpoint) -> tuple[slice, slice]:
    """Returns rows and columns outside of which nothing of an object is seen."""
    radius = bounding_radius(one.shape, one.size)
    right, up, depth = viewpoint.in_camera(one.centre)

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


def _depth(one: Placed, rig: Rig, rays: Doubles) -> Doubles:
    """Returns the distance along the view at which each ray enters an object; infinity where it misses it."""
    angle = radians(one.rotation)
    eye = np.subtract(rig.camera, one.centre)
    x, y = rays[0] * cos(angle) + rays[1] * sin(angle), rays[1] * cos(angle) - rays[0] * sin(angle)
    start = np.array([eye[0] * cos(angle) + eye[1] * sin(angle), eye[1] * cos(angle) - eye[0] * sin(angle), eye[2]])
    if one.shape == "sphere":
        return _between(*_quadric(start, (x, y, rays[2]), RADIUS[one.size]))
    top = _slab(start[2], rays[2], half_height(one.shape, one.size))
    if one.shape == "cylinder":
        return _between(*_overlap(_quadric(start[:2], (x, y), RADIUS[one.size]), top))
    half = half_height(one.shape, one.size)
    return _between(*_overlap(_overlap(_slab(start[0], x, half), _slab(start[1], y, half)), top))


Interval = tuple[Doubles, Doubles]
"""Where each ray enters and leaves; it misses where the first is above the second."""


def _quadric(start: Doubles, rays: Sequence[Doubles], radius: float) -> Interval:
    """A sphere, or an endless cylinder about +z if only x and y are given."""
    a = sum(ray * ray for ray in rays)
    b = sum(ray * at for ray, at in zip(rays, start, strict=True))
    inside = b * b - a * (float(start @ start) - radius * radius)
    root = np.sqrt(np.maximum(inside, 0.0))
    return np.where(inside >= 0, (-b - root) / a, np.inf), np.where(inside >= 0, (-b + root) / a, -np.inf)


def _slab(start: float, ray: Doubles, half: float) -> Interval:
    with np.errstate(divide="ignore"):
        one, other = (-half - start) / ray, (half - start) / ray
    return np.minimum(one, other), np.maximum(one, other)


def _overlap(first: Interval, second: Interval) -> Interval:
    return np.maximum(first[0], second[0]), np.minimum(first[1], second[1])


def _between(enter: Doubles, leave: Doubles) -> Doubles:
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)
