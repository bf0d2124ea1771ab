"""Environment maps: radiance from every direction, on a grid of polar angle and azimuth.

Everywhere in this project row i of a map of `rows` rows is the polar angle θ = (i + ½)π/rows from +y and column j of
`cols` columns the azimuth φ = (j + ½)2π/cols, measured about +y from +z towards +x: the direction
(sin θ sin φ, cos θ, sin θ cos φ).

Equirectangular image files have the opposite azimuth, as they show the sphere from inside: their top row is straight
up, their middle column is +x, and columns further right show +z, −x, −z (the convention of Blender and three.js, with
+y up). `from_image` converts them.

The map `lights` is a scene's own lights as the origin sees them, for the renderer that is lit by a map. Each light is a
round spot (a von Mises-Fisher distribution, the sphere's normal distribution) in its direction, whose irradiance at the
origin is the light's; between them is the ambient light, (1 + y/2) times as bright as its mean. The spots are as wide
as the texels of the default map, so that sums over texels are near the integral: a point light would be a single
texel, which moves by half its width when the map is made coarser.

Maps are OpenEXR images (.exr), Radiance pictures (.hdr), or half floats in an archive of numpy (.npz, an array
`pixels`). The maps of the package are of the last kind: OpenEXR is no part of a plain installation, and a Radiance
picture has 8 bits for a value where these have 11, so that a scene would be lit by other values than the published.

Uploaded maps are not trusted, and are read in a confined process (`scene_attack.scenes.reading.process`). A Radiance
picture (.hdr) has rows of red, green and blue mantissas with a common exponent, run-length encoded: Greg Ward, "Real
Pixels", Graphics Gems II, 1991; the format is described in Radiance's `filefmts.pdf`.
"""

import hashlib
import re
import zipfile
from dataclasses import dataclass
from io import BytesIO
from math import cos, exp, pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene_attack.errors import DAMAGED, InvalidRequest, JobFailure, Unreadable, shortened
from scene_attack.extras import MissingExtra, extra
from scene_attack.scenes.description import Lights
from scene_attack.scenes.mesh import Doubles, Floats


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """An environment map.

    radiance: linear RGB, float32 [rows, cols, 3], finite, ≥ 0, in this project's directions. sha256: the hex digest of
    the file, of a map of the package that of the published OpenEXR file. credit: the attribution line, or None.
    """

    name: str
    radiance: Floats
    sha256: str
    credit: str | None


FILE_KINDS = (".npz", ".exr", ".hdr")
"""Endings of the files that `read_file` reads."""
PUBLISHED = {
    "8fdf60d9adeb767b22f4ae4023549677": "70940108df90c0721799d29f758ca79e67e509d9a2636487e639db7779561524",
    "b9e294132d5a95ef657943f00e2725e0": "4f6810b182ade346eac6964bf02405adf430c321b8853a644316af4e05d0fdb5",
    "f8e344e960b0a8fbb56073aa5554804d": "e501dd8a1172bd0e03903ede7f452300f8368448fe74720600338304d79281d9",
}
"""Half the SHA-256 of the pixels of city, interior and studio in the package, and the SHA-256 of the OpenEXR file that
each was read from. So a map is the same map from either file, and so is the digest of a scene that it lights."""


def read_file(path: Path, credit: str | None) -> EnvironmentMap:
    """Reads a map from an equirectangular image, whose kind is the file's ending (`FILE_KINDS`).

    Raises JobFailure("asset-missing") if the file cannot be read or has no colours, the errors of `radiance_of`, and
    MissingExtra for OpenEXR where it is not installed.
    """
    try:
        data = path.read_bytes()
        digest = hashlib.sha256(data).hexdigest()
        if path.suffix == ".npz":
            pixels = _read_npz(data)
            digest = PUBLISHED.get(hashlib.sha256(pixels.tobytes()).hexdigest()[:32], digest)
        elif path.suffix == ".hdr":
            pixels = read_hdr(data, MAX_TEXELS)
        else:
            pixels = _read_exr(data)
    except MissingExtra:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        raise JobFailure("asset-missing", f"cannot read the environment map {path.name}: {error}") from error
    return EnvironmentMap(path.stem, radiance_of(pixels), digest, credit)


def write_npz(pixels: NDArray[np.float16]) -> bytes:
    """Returns a map's pixels [h,w,3], of which the file's top row is the first, as a .npz file."""
    file = BytesIO()
    np.savez_compressed(file, pixels=pixels)
    return file.getvalue()


def _read_npz(data: bytes) -> NDArray[Any]:
    try:
        with np.load(BytesIO(data), allow_pickle=False) as arrays:
            pixels: NDArray[Any] = arrays["pixels"]
    except (KeyError, AttributeError, EOFError, zipfile.BadZipFile) as error:  # numpy returns an array for a .npy file
        raise Unreadable("it is no archive of numpy with an array `pixels`") from error
    if pixels.dtype != np.float16 or pixels.ndim != 3 or pixels.shape[2] != 3 or not 0 < pixels.size <= 3 * MAX_TEXELS:
        raise Unreadable(f"its pixels are {pixels.dtype} {list(pixels.shape)}, not float16 [height, width, 3]")
    return pixels


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


LIGHTS = "lights"
LIGHTS_ROWS = 128
"""Rows of the map; it has twice as many columns."""
SPOT_WIDTH = 0.15
"""Standard deviation of a light's spot, radians (8.6°)."""
LIGHTS_VERSION = "lights 1"
"""Changes when the same lights give another map: it stands for the map in a scene's digest."""


def lights_map(lights: Lights) -> EnvironmentMap:
    """Returns the map of `lights`, [LIGHTS_ROWS, 2 LIGHTS_ROWS, 3], white.

    A light at the origin itself, and a spot light whose cone misses it, are left out.
    """
    polar = (np.arange(LIGHTS_ROWS) + 0.5) * (pi / LIGHTS_ROWS)
    azimuth = (np.arange(2 * LIGHTS_ROWS) + 0.5) * (pi / LIGHTS_ROWS)
    theta, phi = np.meshgrid(polar, azimuth, indexing="ij")
    directions = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=-1)
    radiance = lights.ambient * (1 + directions[..., 1] / 2)
    for towards, irradiance in _seen_from_the_origin(lights):
        radiance += irradiance * _spot(directions @ towards)
    values = np.repeat(radiance[..., None], 3, axis=-1).astype(np.float32)
    return EnvironmentMap(LIGHTS, values, hashlib.sha256(LIGHTS_VERSION.encode()).hexdigest(), credit=None)


def _seen_from_the_origin(lights: Lights) -> list[tuple[Doubles, float]]:
    """Returns each light's direction, a unit vector, and its irradiance on a surface that faces it."""
    sources = []
    for point in lights.points:
        sources.append((np.array(point.position, float), point.energy))
    for spot in lights.spots:
        place, axis = np.array(spot.position, float), np.array(spot.direction, float)
        distance = np.linalg.norm(place)
        if distance > 0:
            cosine = float(-(place @ axis) / (distance * np.linalg.norm(axis)))
            inner, outer = cos(spot.inner_angle), cos(spot.outer_angle)
            share = min(1.0, max(0.0, (cosine - outer) / max(inner - outer, 1e-9)))
            sources.append((place, spot.energy * share**2))
    near = [(place / np.linalg.norm(place), energy / float(place @ place)) for place, energy in sources if place.any()]
    far = [(-np.array(light.direction, float), light.energy) for light in lights.directional]
    return near + [(towards / np.linalg.norm(towards), energy) for towards, energy in far]


def _spot(cosine: Doubles) -> Doubles:
    """Returns the density of the spot at cosines of the angle to its middle; its integral over the sphere is 1."""
    kappa = 1 / SPOT_WIDTH**2
    density: Doubles = kappa / (2 * pi * (1 - exp(-2 * kappa))) * np.exp(kappa * (cosine - 1))
    return density


_SHORTEST, _LONGEST = 8, 0x7FFF
"""Widths of rows whose channels are encoded one after another."""
_HEADER = 2**16


def read_hdr(data: bytes, most: int) -> Floats:
    """Returns the pixels, float32 [h,w,3], row 0 at the top; radiance, so that the header's exposures are divided out.

    Raises Unreadable if the bytes are no picture of this kind, are cut off, or have more than `most` pixels.
    """
    header, blank, rest = data[:_HEADER].partition(b"\n\n")
    if not re.match(rb"#\?(?:RADIANCE|RGBE)\b", data) or not blank:
        raise Unreadable("it does not begin with the header of a Radiance picture, #?RADIANCE")
    if b"FORMAT=32-bit_rle_rgbe" not in header:
        raise Unreadable("its header does not say FORMAT=32-bit_rle_rgbe")
    size, newline, _ = rest.partition(b"\n")
    match = re.fullmatch(rb"-Y (\d{1,6}) \+X (\d{1,6})", size.strip())
    if match is None or not newline:
        raise Unreadable(f"its size is {size[:40].decode('latin-1')!r}; -Y <height> +X <width> is read")
    height, width = int(match[1]), int(match[2])
    if not 0 < height * width <= most:
        raise Unreadable(f"it has {width:,}×{height:,} texels; at most {most:,} are taken")
    exposure = 1.0
    for stated in re.findall(rb"(?m)^EXPOSURE=\s*(\S+)", header):
        try:
            exposure *= float(stated)
        except ValueError as error:
            raise Unreadable(f"its EXPOSURE is {stated[:40].decode('latin-1')!r}, which is no number") from error
    start = len(header) + len(blank) + len(size) + len(newline)
    rgbe = _rows(memoryview(data)[start:], height, width)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        scale = np.where(rgbe[..., 3] > 0, np.ldexp(1.0, rgbe[..., 3].astype(int) - 136), 0.0) / exposure
        return (rgbe[..., :3] * scale[..., None]).astype(np.float32)


def _rows(data: memoryview, height: int, width: int) -> NDArray[np.uint8]:
    pixels = np.empty((height, width, 4), np.uint8)
    place = 0
    for row in pixels:
        head = bytes(data[place : place + 4])
        if len(head) < 4:
            raise Unreadable("it is cut off")
        if _SHORTEST <= width <= _LONGEST and head[:2] == b"\2\2" and head[2] << 8 | head[3] == width:
            place = _channels(data, place + 4, row)
        else:
            flat = np.frombuffer(data[place : place + 4 * width], np.uint8)
            if len(flat) < 4 * width:
                raise Unreadable("it is cut off")
            row[:] = flat.reshape(width, 4)
            if (row[:, :3] == 1).all(axis=1).any():
                raise Unreadable("its rows are encoded as before 1991, which is not read")
            place += 4 * width
    return pixels


def _channels(data: memoryview, place: int, row: NDArray[np.uint8]) -> int:
    """Decodes the four channels of a row [w,4]; returns the place after them."""
    width = len(row)
    for channel in range(4):
        column = 0
        while column < width:
            if place + 1 >= len(data):
                raise Unreadable("it is cut off")
            count = data[place]
            run = count > 128
            length = count - 128 if run else count
            if length == 0 or column + length > width:
                raise Unreadable("a run of its pixels is longer than the row")
            values = data[place + 1 : place + 2 + (0 if run else length - 1)]
            if len(values) < (1 if run else length):
                raise Unreadable("it is cut off")
            row[column : column + length, channel] = values[0] if run else np.frombuffer(values, np.uint8)
            place += 2 if run else 1 + length
            column += length
    return place


MAX_TEXELS = 2**25
"""Largest map, texels: 8192 × 4096."""
MAX_ROWS = 1024
"""Rows that are kept at most. Scenes are lit by at most 64 of them; a picture of the map as background takes more."""


def read_map(data: bytes, kind: str) -> Floats:
    """Returns the texels of an equirectangular map, linear RGB, float32 [h,w,3] with at most MAX_ROWS rows.

    `kind` is hdr or exr. Raises MissingExtra for exr without OpenEXR, and InvalidRequest("file", …) if the bytes are no
    such image, or if it has more than MAX_TEXELS texels, or texels that are negative or not finite.
    """
    try:
        texels = read_hdr(data, MAX_TEXELS) if kind == "hdr" else _read_exr(data)
    except (MemoryError, MissingExtra):
        raise
    except Exception as error:  # OpenEXR raises many types of exceptions
        message = shortened(error) if isinstance(error, Unreadable) else DAMAGED
        raise InvalidRequest("file", f"it is not a readable {kind} map: {message}") from error
    infinite = int((~np.isfinite(texels)).any(axis=-1).sum())
    negative = int((texels < 0).any(axis=-1).sum())
    for count, what in ((infinite, "not finite numbers"), (negative, "negative")):
        if count:
            raise InvalidRequest(
                "file", f"{count:,} of its texels are {what}; the radiance of a map is a finite number of at least 0"
            )
    return _reduced(texels)


def _read_exr(data: bytes) -> Floats:
    with extra("formats", "an OpenEXR image (.exr)", "file"):
        import Imath
        import OpenEXR

    file = OpenEXR.InputFile(BytesIO(data))
    try:
        header = file.header()
        window = header["dataWindow"]
        width, height = window.max.x - window.min.x + 1, window.max.y - window.min.y + 1
        if not 0 < width * height <= MAX_TEXELS:
            raise Unreadable(f"it has {width:,}×{height:,} texels; at most {MAX_TEXELS:,} are taken")
        missing = [name for name in "RGB" if name not in header["channels"]]
        if missing:
            raise Unreadable(f"it has no channel {missing[0]}")
        planes = file.channels("RGB", Imath.PixelType(Imath.PixelType.FLOAT))
    finally:
        file.close()
    return np.stack([np.frombuffer(plane, np.float32).reshape(height, width) for plane in planes], axis=-1)


def _reduced(texels: Floats) -> Floats:
    """Averages square blocks of texels, weighted by their solid angles, until there are at most MAX_ROWS rows."""
    block = -(-texels.shape[0] // MAX_ROWS)
    if block == 1:
        return texels
    rows, columns = texels.shape[0] // block * block, texels.shape[1] // block * block
    weights = np.sin((np.arange(rows) + 0.5) * (np.pi / texels.shape[0])).reshape(-1, block)
    weights /= weights.sum(axis=1, keepdims=True)
    blocks = texels[:rows, :columns].reshape(rows // block, block, columns // block, block, 3).mean(axis=3)
    reduced: Floats = np.einsum("rb,rbcd->rcd", weights, blocks).astype(np.float32)
    return reduced
