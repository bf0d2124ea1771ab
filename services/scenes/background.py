"""What is behind a scene's objects: its environment map as a camera sees it, or a picture."""

import base64
import binascii
from math import pi

import numpy as np

from services.errors import InvalidRequest
from services.scenes.isolated_reading import reader
from services.scenes.mesh import Doubles, Floats
from services.scenes.srgb import to_display

WHITE = 0.9
"""Linear value of the brightest channel of the white Lambertian surface that a map lights most; the torch renderer's
exposure is the same, so that objects and background fit together."""
PROBES = (16, 32)
"""Rows and columns of the grid of normals among which that surface is found."""
SAMPLES = 2
"""Rays a side of each pixel, whose radiances are averaged."""


def read_picture(text: str, size: tuple[int, int]) -> Doubles:
    """Returns a PNG, JPEG or WebP file in base64 as displayed values in [0,1], float64 [H, W, 3].

    Raises InvalidRequest("image") unless it is such an image of height and width `size`.
    """
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InvalidRequest("image", "it is not base64") from error
    return np.asarray(reader().read_image(data, size) / 255)


def exposure_of(environment: Floats) -> float:
    """Returns the factor from a map's radiance [rows, cols, 3] to linear display values, by `WHITE`; 0 if it is black.

    The map is the one that lights the scene, averaged down to its size.
    """
    rows, cols = environment.shape[:2]
    strongest = float(environment.max())
    if strongest == 0:
        return 0.0
    edges = np.cos(np.linspace(0, pi, rows + 1))
    solid = np.repeat((edges[:-1] - edges[1:]) * (2 * pi / cols), cols)
    power = (environment.astype(np.float64) / strongest).reshape(-1, 3) * solid[:, None]
    cosines = (_directions(*PROBES) @ _directions(rows, cols).T).clip(min=0)
    return WHITE / float((cosines @ power / pi).max()) / strongest


def _directions(rows: int, cols: int) -> Doubles:
    theta, phi = np.meshgrid(
        (np.arange(rows) + 0.5) * pi / rows, (np.arange(cols) + 0.5) * 2 * pi / cols, indexing="ij"
    )
    vectors = np.stack((np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)), axis=-1)
    return vectors.reshape(-1, 3)


def displayed_map(
    radiance: Floats, exposure: float, turn: float, clip_from_world: Doubles, size: tuple[int, int]
) -> Doubles:
    """Returns a map as a camera sees it, displayed values in [0,1], float64 [H, W, 3], multiples of 1/255.

    radiance: the map [rows, cols, 3], interpolated linearly between texel centres. turn: about +y, radians, as
    `environment.average` turns it. clip_from_world: float64 [4,4]. size: height and width H, W.
    """
    height, width = size
    x = (np.arange(width * SAMPLES) + 0.5) * 2 / (width * SAMPLES) - 1
    y = 1 - (np.arange(height * SAMPLES) + 0.5) * 2 / (height * SAMPLES)
    down, right = np.meshgrid(y, x, indexing="ij")
    ends = []
    for depth in (-1.0, 1.0):  # on the near and on the far plane
        points = np.stack((right, down, np.full_like(right, depth), np.ones_like(right)), axis=-1)
        points = points @ np.linalg.inv(clip_from_world).T
        ends.append(points[..., :3] / points[..., 3:])
    rays = ends[1] - ends[0]
    seen = _looked_up(radiance, rays, turn).reshape(height, SAMPLES, width, SAMPLES, 3).mean(axis=(1, 3))
    return np.asarray(np.round(to_display(exposure * seen) * 255) / 255)


def _looked_up(radiance: Floats, rays: Doubles, turn: float) -> Doubles:
    """The radiance [..., 3] of a map in the directions of rays [..., 3] of any length."""
    rows, cols = radiance.shape[:2]
    across = np.hypot(rays[..., 0], rays[..., 2])
    row = np.arctan2(across, rays[..., 1]) / pi * rows - 0.5
    col = np.mod(np.arctan2(rays[..., 0], rays[..., 2]) - turn, 2 * pi) / (2 * pi) * cols - 0.5
    top, left = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    down, right = (row - top)[..., None], (col - left)[..., None]
    above, below = top.clip(0, rows - 1), (top + 1).clip(0, rows - 1)
    before, after = np.mod(left, cols), np.mod(left + 1, cols)
    upper = (1 - right) * radiance[above, before] + right * radiance[above, after]
    lower = (1 - right) * radiance[below, before] + right * radiance[below, after]
    return np.asarray((1 - down) * upper + down * lower)
