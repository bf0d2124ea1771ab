"""Where in the picture objects can be."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rectangle = tuple[int, int, int, int]
"""Rows from and to, columns from and to; the first row is the top."""


def is_in_front(points: Array, clip_from_object: Array) -> bool:
    """Whether homogeneous points [V,4] are all beyond the camera's near plane."""
    height = points @ (clip_from_object[3] + clip_from_object[2])
    return bool(height.min(initial=np.inf) > 0)


def beyond(points: Array, clip_from_object: Array, margin: float) -> bool:
    """Whether points [V,4] are all beyond one plane of the camera's frustum, by a `margin` in the units they are in."""
    for axis in range(3):
        for sign in (1, -1):
            plane = clip_from_object[3] + sign * clip_from_object[axis]
            if bool((points @ plane).max(initial=-np.inf) < -margin * np.linalg.norm(plane[:3])):
                return True
    return False


def rectangle(points: Sequence[Array], clip_from_object: Sequence[Array], size: tuple[int, int]) -> Rectangle:
    """The part of a picture of `size` (height, width) that objects of corners [V,4] can cover; empty if they cannot.

    A triangle's picture lies within that of its corners as long as these are before the camera; if one is not, it is
    the whole picture. A pixel is added around for the rounding of OpenGL's arithmetic.
    """
    height, width = size
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for corners, matrix in zip(points, clip_from_object, strict=True):
        if not is_in_front(corners, matrix):
            return 0, height, 0, width
        clip = corners @ matrix.T
        seen = (1 + clip[:, :2] / clip[:, 3:] * (1, -1)) / 2 * (width, height)
        low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    left, top = np.clip(np.floor(low) - 1, 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(high) + 1, 0, (width, height)).astype(int)
    if left >= right or top >= bottom:
        return 0, 0, 0, 0
    return int(top), int(bottom), int(left), int(right)
