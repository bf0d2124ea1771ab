"""Images that are not trusted: three formats are opened by their first bytes, large ones refused by their headers."""

import struct
import zlib
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from scene_attack.scenes.image_file import MAX_PIXELS, open_image
from tests.unit.scenes.test_gltf import one, read, texture_of

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"
COLORS = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)


def stored(kind: str, **options: object) -> bytes:
    buffer = BytesIO()
    Image.fromarray(COLORS).save(buffer, kind, **options)
    return buffer.getvalue()


def png_of_size(width: int, height: int) -> bytes:
    """A PNG whose header states a size, and whose pixels are missing."""
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")]
    body = b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + body


def riff(chunk: bytes) -> bytes:
    return b"RIFF" + struct.pack("<I", 4 + len(chunk)) + b"WEBP" + chunk


def vp8x(width: int, height: int) -> bytes:
    return riff(
        b"VP8X"
        + struct.pack("<I", 10)
        + bytes(4)
        + struct.pack("<I", width - 1)[:3]
        + struct.pack("<I", height - 1)[:3]
    )


@pytest.mark.parametrize(
    ("kind", "options"),
    [("PNG", {}), ("JPEG", {"quality": 95}), ("WEBP", {"lossless": True}), ("WEBP", {"quality": 90})],
)
def test_the_three_formats_are_opened(kind, options):
    image = open_image(stored(kind, **options))
    assert (image.format, image.size) == (kind, (7, 5))
    if kind == "PNG" or options.get("lossless"):
        assert (np.asarray(image.convert("RGB")) == COLORS).all()


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", POSTSCRIPT, b"RIFF" + bytes(4) + b"AVI LIST", b"<svg/>"])
def test_other_bytes_are_refused_before_pillow_sees_them(data, monkeypatch):
    monkeypatch.setattr(Image, "open", lambda *_, **__: pytest.fail("Pillow was asked"))
    with pytest.raises(ValueError, match="no PNG, JPEG or WebP image"):
        open_image(data)


@pytest.mark.parametrize("kind", ["BMP", "GIF", "TIFF", "EPS", "ICO", "PPM", "TGA", "PCX"])
def test_other_formats_of_pillow_are_refused(kind):
    with pytest.raises(ValueError, match="no PNG, JPEG or WebP image"):
        open_image(stored(kind))


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_a_damaged_image_is_refused(kind):
    data = stored(kind)
    for length in range(0, len(data) // 2, 7):
        with pytest.raises((ValueError, OSError)):
            open_image(data[:length]).load()


@pytest.mark.parametrize(
    "data",
    [
        png_of_size(2**13, 2**13 + 1),
        png_of_size(2**31 - 1, 2**31 - 1),
        vp8x(2**13, 2**13 + 1),
        vp8x(2**24, 2**24),
        riff(b"VP8L" + struct.pack("<IBI", 5, 0x2F, (1 << 28) - 1)),
        riff(b"VP8 " + struct.pack("<I", 10) + b"\x10\0\0\x9d\x01\x2a" + struct.pack("<HH", 16383, 16383)),
    ],
)
def test_an_image_of_too_many_pixels_is_refused_by_its_header(data, monkeypatch):
    monkeypatch.setattr(Image.Image, "load", lambda _: pytest.fail("it was decoded"))
    if b"WEBP" in data:
        monkeypatch.setattr(Image, "open", lambda *_, **__: pytest.fail("Pillow allocates the canvas of a WebP file"))
    with pytest.raises(ValueError, match=f"pixels; at most {MAX_PIXELS:,}|more than {MAX_PIXELS:,} pixels"):
        open_image(data)


def test_the_largest_image_is_taken():
    assert open_image(png_of_size(2**13, 2**13)).size == (2**13, 2**13)


def test_a_webp_texture_is_read_by_its_extension():
    writer = one({}, texture_of(stored("WEBP", lossless=True)), TEXCOORD_0=[[0, 0]] * 3)
    texture = writer.tree["textures"][0]
    texture["extensions"] = {"EXT_texture_webp": {"source": texture.pop("source")}}
    writer.tree.update(extensionsUsed=["EXT_texture_webp"], extensionsRequired=["EXT_texture_webp"])
    (part,) = read(writer)
    assert part.metallic_roughness is not None
    assert (part.metallic_roughness.maps["emissive"].texels[..., :3] == COLORS).all()
