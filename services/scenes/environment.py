"""Environment maps: radiance from every direction, on a grid of polar angle and azimuth.

Everywhere in this project row i of a map of `rows` rows is the polar angle θ = (i + ½)π/rows from +y and column j of
`cols` columns the azimuth φ = (j + ½)2π/cols, measured about +y from +z towards +x: the direction
(sin θ sin φ, cos θ, sin θ cos φ).

Equirectangular image files have the opposite azimuth, as they show the sphere from inside: their top row is straight
up, their middle column is +x, and columns further right show +z, −x, −z (the convention of Blender and three.js, with
+y up). `from_image` converts them.
"""

import hashlib
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from services.errors import InvalidRequest, JobFailure
from services.scenes.mesh import Doubles, Floats


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """An environment map.

    radiance: linear RGB, float32 [rows, cols, 3], finite, ≥ 0, in this project's directions. sha256: the hex digest of
    the file. credit: the attribution line, or None.
    """

    name: str
    radiance: Floats
    sha256: str
    credit: str | None


def read_exr(path: Path, credit: str | None) -> EnvironmentMap:
    """Reads a map from an equirectangular OpenEXR image.

    Raises JobFailure("asset-missing") if the file cannot be read or has no colours, and the errors of `radiance_of`.
    """
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        with OpenEXR.File(str(path)) as file:
            channels = file.channels()
            if "RGBA" in channels or "RGB" in channels:
                pixels = np.asarray(channels["RGBA" if "RGBA" in channels else "RGB"].pixels)[..., :3]
            else:
                pixels = np.stack([np.asarray(channels[name].pixels) for name in "RGB"], axis=-1)
    except (OSError, KeyError, RuntimeError, ValueError) as error:
        raise JobFailure("asset-missing", f"cannot read the environment map {path.name}: {error}") from error
    return EnvironmentMap(name=path.stem, radiance=radiance_of(pixels), sha256=digest, credit=credit)


def uniform() -> EnvironmentMap:
    """Returns the map with radiance 1 in every direction."""
    radiance = np.ones((1, 4, 3), np.float32)
    return EnvironmentMap("uniform", radiance, hashlib.sha256(radiance.tobytes()).hexdigest(), credit=None)


def radiance_of(pixels: NDArray[Any]) -> Floats:
    """Converts the pixels [h,w,3] of an equirectangular file to radiance, float32, in this project's directions.

    Negative values, which filters leave beside bright spots, become 0. Raises InvalidRequest("environment", …) for
    values that are not finite: an overflowed value was bright, and its radiance is unknown.
    """
    values = np.asarray(pixels, np.float32)
    bad = int((~np.isfinite(values)).any(axis=-1).sum())
    if bad:
        raise InvalidRequest(
            "environment", f"{bad:,} of its texels are not finite numbers; write them as finite radiance"
        )
    return from_image(values.clip(min=0.0))


def from_image(image: Floats) -> Floats:
    """Converts an equirectangular image [h,w,3] to this project's directions (see the module's docstring)."""
    width = image.shape[1]
    mirrored = image[:, ::-1]
    # Image position u (0 left, 1 right) looks along the azimuth φ = 2π(¾ − u); mirrored, 1 − u comes first.
    if width % 4 == 0:
        return np.ascontiguousarray(np.roll(mirrored, -width // 4, axis=1))
    weights = _column_weights(width, width, -pi / 2)
    image64: Doubles = np.einsum("jw,hwc->hjc", weights, mirrored.astype(np.float64))
    return image64.astype(np.float32)


def average(radiance: Floats, rows: int, cols: int, rotation: float = 0.0) -> Floats:
    """Averages a map to `rows` × `cols` texels, turned about +y by `rotation` radians: float32 [rows, cols, 3].

    Every texel is the mean radiance over its solid angle, weighted by the solid angle shared with each source texel, so
    the integral over the sphere is the same for any grid. Positive rotations turn +z towards +x.
    """
    height, width = radiance.shape[:2]
    source = np.cos(np.linspace(0, pi, height + 1))
    target = np.cos(np.linspace(0, pi, rows + 1))
    shared = np.minimum(target[:-1, None], source[None, :-1]) - np.maximum(target[1:, None], source[None, 1:])
    vertical = shared.clip(min=0) / (target[:-1] - target[1:])[:, None]
    horizontal = _column_weights(width, cols, rotation)
    out: Doubles = np.einsum("ih,hwc->iwc", vertical, radiance.astype(np.float64), optimize=True)
    out = np.einsum("jw,iwc->ijc", horizontal, out, optimize=True)
    return out.astype(np.float32)


def _column_weights(width: int, cols: int, rotation: float) -> Doubles:
    """Returns the weight of each source column in each target column, [cols, width]; rows sum to 1."""
    # In units of source columns: target column j covers [low, low + span) of the unturned map, modulo the width.
    span = width / cols
    low = np.arange(cols) * span - rotation / (2 * pi) * width
    left = np.arange(width)
    weights = np.zeros((cols, width))
    # Shifts by whole turns, enough for low in any position and a span of up to a full turn.
    start = np.mod(low, width)[:, None]
    for turn in (0, width):
        overlap = np.minimum(start + span, left + 1 + turn) - np.maximum(start, left + turn)
        weights += overlap.clip(min=0)
    return weights / span
