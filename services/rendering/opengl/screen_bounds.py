"""Where in the image objects can be."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rectangle = tuple[int, int, int, int]
"""Rows from and to, columns from and to; the first row is the top."""


def is_in_front(points: Array, clip_from_object: Array) -> bool:
    """Whether homogeneous points [4,V] are all beyond the camera's near plane."""
    height = (clip_from_object[3] + clip_from_object[2]) @ points
    return bool(height.min(initial=np.inf) > 0)


def beyond(points: Array, clip_from_object: Array, margin: float) -> bool:
    """Whether points [4,V] are all beyond one plane of the camera's frustum, by a `margin` in the units they are in."""
    for axis in range(3):
        for sign in (1, -1):
            plane = clip_from_object[3] + sign * clip_from_object[axis]
            if bool((plane @ points).max(initial=-np.inf) < -margin * np.linalg.norm(plane[:3])):
                return True
    return False


def rectangle(points: Sequence[Array], clip_from_object: Sequence[Array], size: tuple[int, int]) -> Rectangle:
    """The part of an image of `size` (height, width) that objects of corners [4,V] can cover; empty if they cannot.

    A triangle's image lies within that of its corners as long as these are before the camera; if one is not, it is
    the whole image. A pixel is added around for the rounding of OpenGL's arithmetic.
    """
    height, width = size
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for corners, matrix in zip(points, clip_from_object, strict=True):
        if not is_in_front(corners, matrix):
            return 0, height, 0, width
        x, y, w = matrix[[0, 1, 3]] @ corners
        x, y = x / w, y / w
        low = np.minimum(low, ((1 + x.min()) / 2 * width, (1 - y.max()) / 2 * height))
        high = np.maximum(high, ((1 + x.max()) / 2 * width, (1 - y.min()) / 2 * height))
    left, top = np.clip(np.floor(low) - 1, 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(high) + 1, 0, (width, height)).astype(int)
    if left >= right or top >= bottom:
        return 0, 0, 0, 0
    return int(top), int(bottom), int(left), int(right)
