"""Reads Radiance pictures (.hdr): rows of red, green and blue mantissas with a common exponent, run-length encoded.

Greg Ward, "Real Pixels", Graphics Gems II, 1991; the format is described in Radiance's `filefmts.pdf`.
"""

import re

import numpy as np
from numpy.typing import NDArray

from services.scenes.mesh import Floats
from services.scenes.unreadable import Unreadable

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
    found = re.fullmatch(rb"-Y (\d{1,6}) \+X (\d{1,6})", size.strip())
    if found is None or not newline:
        raise Unreadable(f"its size is {size[:40].decode('latin-1')!r}; -Y <height> +X <width> is read")
    height, width = int(found[1]), int(found[2])
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
