"""Images on disk, and the perturbation made visible."""

from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

MAGNIFICATION = 5
"""As in the paper's figures: five times, around 128."""


def magnified(original: Tensor, attacked: Tensor) -> Tensor:
    """(attacked − original)·5 + 128, clipped; all uint8 [H, W, 3]."""
    change = attacked.to(torch.int32) - original.to(torch.int32)
    return (change * MAGNIFICATION + 128).clamp(0, 255).to(torch.uint8)


def save_png(image: Tensor, path: Path) -> None:
    """Writes a uint8 image [H, W, 3]; the same image gives the same bytes."""
    Image.fromarray(image.numpy()).save(path, format="PNG", optimize=False)


def load_png(path: Path) -> Tensor:
    """A saved image, uint8 [H, W, 3]."""
    with Image.open(path) as image:
        return torch.frombuffer(bytearray(image.convert("RGB").tobytes()), dtype=torch.uint8).reshape(
            image.height, image.width, 3
        )
