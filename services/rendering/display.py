"""From linear radiance to the picture on a screen, and to the 8 bits of a file."""

import torch
from torch import Tensor


def to_display(linear: Tensor) -> Tensor:
    """The sRGB curve on radiance clipped to [0,1] (IEC 61966-2-1). Any shape; gradients are finite everywhere.

    Clipped values have a zero gradient.
    """
    clipped = linear.clamp(0.0, 1.0)
    # The power is only ever taken above the knee, so that its infinite slope at 0 never meets a gradient. It is taken
    # through the logarithm: torch's own power in float32 has other last bits at the end of a tensor than in its middle,
    # so that a picture's would depend on its batch.
    curved = 1.055 * (clipped.clamp_min(0.0031308).log() / 2.4).exp() - 0.055
    return torch.where(clipped <= 0.0031308, 12.92 * clipped, curved)


def to_linear(display: Tensor) -> Tensor:
    """The inverse of `to_display` on [0,1]."""
    low = display <= 0.04045
    return torch.where(low, display / 12.92, ((display.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def to_bytes(images: Tensor) -> Tensor:
    """Images in [0,1] as they are saved: uint8, rounded to nearest (ties to even)."""
    # A product with 255 in a type of eight bits would be rounded twice.
    wide = images.detach().to(torch.promote_types(images.dtype, torch.float32))
    return (wide.clamp(0.0, 1.0) * 255).round().to(torch.uint8)


def from_bytes(images: Tensor) -> Tensor:
    """uint8 images as float32 in [0,1]."""
    return images.to(torch.float32) / 255


def as_saved(images: Tensor) -> Tensor:
    """What a reader of the saved file sees: rounded to 8 bits, float32."""
    return from_bytes(to_bytes(images))
