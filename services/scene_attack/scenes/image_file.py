"""Pictures that are not trusted: opens PNG, JPEG and WebP, no other format that Pillow knows; and the curve of sRGB.

Pillow asks each of its plug-ins whether it knows a file, and some run a program on it (Ghostscript on PostScript). The
format is therefore chosen here, by the file's first bytes, and Pillow is given that one plug-in.
"""

import re
import struct
import warnings
from io import BytesIO

import numpy as np
from PIL import Image

from scene_attack.errors import InvalidRequest, Unreadable
from scene_attack.scenes.mesh import Bytes, Doubles

FORMATS = "PNG, JPEG or WebP"
MAX_PIXELS = 2**26
"""Largest image, pixels; a decoded one takes 4 bytes for each."""
_SIGNATURES = {"PNG": rb"\x89PNG\r\n\x1a\n", "JPEG": rb"\xff\xd8\xff", "WEBP": rb"RIFF....WEBPVP8"}


def open_image(data: bytes) -> Image.Image:
    """Returns an image, not yet decoded. Its size is read from the header.

    Raises Unreadable if the bytes are no PNG, JPEG or WebP image, or if the image has more than MAX_PIXELS.
    """
    kind = next((name for name, mark in _SIGNATURES.items() if re.match(mark, data, re.DOTALL)), None)
    if kind is None:
        raise Unreadable(f"it is no {FORMATS} image")
    return _opened(data, kind)


def _opened(data: bytes, kind: str) -> Image.Image:
    try:
        if kind == "WEBP":  # Pillow's plug-in allocates the canvas while it opens the file
            _check_size(*_webp_size(data))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(BytesIO(data), formats=(kind,))
    except (OSError, SyntaxError, struct.error) as error:
        raise Unreadable(f"it is a damaged {kind} image") from error
    except Image.DecompressionBombError as error:
        raise Unreadable(f"it has more than {MAX_PIXELS:,} pixels") from error
    _check_size(image.width, image.height)
    return image


def open_texture(data: bytes, name: str) -> Image.Image:
    """Returns a texture that a mesh names, not yet decoded: of `open_image`'s formats, or BMP, GIF or TGA.

    A TGA file has no signature and is known by its name alone. Raises Unreadable.
    """
    kind = next((kind for kind, mark in (("BMP", b"BM"), ("GIF", b"GIF8")) if data.startswith(mark)), None)
    kind = "TGA" if name.lower().endswith(".tga") else kind
    if kind is None:
        try:
            return open_image(data)
        except Unreadable as error:
            raise Unreadable(str(error).replace(FORMATS, "PNG, JPEG, WebP, BMP, GIF or TGA")) from error
    return _opened(data, kind)


def read_image(data: bytes, size: tuple[int, int]) -> Bytes:
    """Returns an image as uint8 [H, W, 3]. Its height and width must be `size`, which is checked before it is decoded.

    Raises InvalidRequest("image").
    """
    try:
        image = open_image(data)
        if (image.height, image.width) != tuple(size):
            raise InvalidRequest("image", other_size((image.height, image.width), size))
        return np.asarray(image.convert("RGB"), np.uint8)
    except (InvalidRequest, MemoryError):
        raise
    except Exception as error:  # Pillow's parsers raise errors of many kinds for a damaged file
        raise InvalidRequest("image", f"it is not a {FORMATS} file, or it is damaged") from error


def other_size(actual: tuple[int, int], size: tuple[int, int]) -> str:
    """Says that an image has another size, both as height and width, than the camera of its scene."""
    camera = f"{size[1]}×{size[0]} (scene.camera.size)"
    return f"it has {actual[1]}×{actual[0]} pixels; the camera of the scene has {camera}"


def _check_size(width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise Unreadable(f"it has {width:,}×{height:,} pixels; at most {MAX_PIXELS:,} are taken")


def _webp_size(data: bytes) -> tuple[int, int]:
    """Width and height of a WebP file's canvas (RFC 9649, 2.5 to 2.7). Raises struct.error if the header is cut off."""
    kind = data[12:16]
    if kind == b"VP8X":
        low, high, low_down, high_down = struct.unpack_from("<HBHB", data, 24)
        return 1 + low + (high << 16), 1 + low_down + (high_down << 16)
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


def to_linear(display: Doubles) -> Doubles:
    """Returns the linear values of displayed sRGB values in [0,1], of any shape: the inverse curve of IEC 61966-2-1."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def to_display(linear: Doubles) -> Doubles:
    """Returns the displayed sRGB values of linear values of any shape, clipped to [0,1] (IEC 61966-2-1)."""
    clipped = linear.clip(0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
