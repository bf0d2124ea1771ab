"""Reads environment maps that are not trusted, in a confined process (`services.scenes.reading_process`).

A Radiance picture (.hdr) has rows of red, green and blue mantissas with a common exponent, run-length encoded: Greg
Ward, "Real Pixels", Graphics Gems II, 1991; the format is described in Radiance's `filefmts.pdf`.
"""

import re
from io import BytesIO

import Imath
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from services.errors import InvalidRequest, shortened
from services.scenes.mesh import Floats
from services.scenes.unreadable import DAMAGED, Unreadable

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

    `kind` is hdr or exr. Raises InvalidRequest("file", …) if the bytes are no such image, or if it has more than
    MAX_TEXELS texels, or texels that are negative or not finite.
    """
    try:
        texels = read_hdr(data, MAX_TEXELS) if kind == "hdr" else _read_exr(data)
    except MemoryError:
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
