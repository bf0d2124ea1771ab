"""Reads environment maps that are not trusted, in a confined process (`services.scenes.reading_process`)."""

from io import BytesIO

import Imath
import numpy as np
import OpenEXR

from services.errors import InvalidRequest, shortened
from services.scenes.mesh import Floats
from services.scenes.radiance_file import read_hdr
from services.scenes.unreadable import DAMAGED, Unreadable

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
        said = shortened(error) if isinstance(error, Unreadable) else DAMAGED
        raise InvalidRequest("file", f"it is not a readable {kind} map: {said}") from error
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
    return np.stack([np.frombuffer(one, np.float32).reshape(height, width) for one in planes], axis=-1)


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
