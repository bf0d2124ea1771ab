"""Reads and writes PNG files, and makes a visible image of the perturbation."""

from io import BytesIO
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

MAGNIFICATION = 5
"""Factor by which differences are shown, as in the paper's figures."""


def magnified(original: Tensor, attacked: Tensor) -> Tensor:
    """The image (attacked − original)·5 + 128, clipped to 0…255; all three images are uint8 [H, W, 3]."""
    change = attacked.to(torch.int32) - original.to(torch.int32)
    return (change * MAGNIFICATION + 128).clamp(0, 255).to(torch.uint8)


def save_png(image: Tensor, path: Path) -> None:
    """Writes a uint8 image [H, W, 3]; the same image gives the same bytes."""
    path.write_bytes(png(image))


def png(image: Tensor) -> bytes:
    """A uint8 image [H, W, 3] as the bytes of a PNG file."""
    buffer = BytesIO()
    Image.fromarray(image.numpy()).save(buffer, format="PNG", optimize=False)
    return buffer.getvalue()


def load_png(path: Path) -> Tensor:
    """Reads an image as uint8 [H, W, 3]. Raises OSError, also for a file that is not an image."""
    with Image.open(path) as image:
        return pixels(image)


def pixels(image: Image.Image) -> Tensor:
    """An image as uint8 [H, W, 3]."""
    data = bytearray(image.convert("RGB").tobytes())
    return torch.frombuffer(data, dtype=torch.uint8).reshape(image.height, image.width, 3)
