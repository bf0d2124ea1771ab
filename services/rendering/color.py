"""From linear radiance to the image on a screen, and to the 8 bits of a file."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from services.rendering.kernels import compiled

KNEE = 0.0031308
"""Linear values up to here are displayed in proportion."""


def to_display(linear: Tensor) -> Tensor:
    """The sRGB curve on radiance clipped to [0,1] (IEC 61966-2-1). Any shape. Differentiable (once); gradients are
    finite everywhere, and zero where values are clipped.
    """
    result: Tensor = _Display.apply(linear)  # type: ignore[no-untyped-call]
    return result


def display_derivative(linear: Tensor) -> Tensor:
    """The curve's derivative."""
    # The power is only ever taken above the knee, so that its infinite derivative at 0 is not met.
    above = linear.clamp(KNEE, 1.0)
    derivative = torch.where(linear <= KNEE, 12.92, 1.055 / 2.4 * (above.log() * (1 / 2.4 - 1)).exp())
    return derivative * ((linear >= 0) & (linear <= 1))


class _Display(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, linear: Tensor) -> Tensor:
        ctx.save_for_backward(linear)
        if compiled.runs(linear):
            shown = torch.empty_like(linear, memory_format=torch.contiguous_format)
            compiled.call("display", linear.dtype, linear.numel(), linear.contiguous(), shown, compiled.threads())
            return shown
        clipped = linear.clamp(0.0, 1.0)
        # Through the logarithm: torch's own power in float32 has other last bits at the end of a tensor than in its
        # middle, so that an image's would depend on its batch.
        curved = 1.055 * (clipped.clamp_min(KNEE).log() / 2.4).exp() - 0.055
        return torch.where(clipped <= KNEE, 12.92 * clipped, curved)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_output: Tensor) -> Tensor:
        return grad_output * display_derivative(*ctx.saved_tensors)


def to_bytes(images: Tensor) -> Tensor:
    """Images in [0,1] as they are saved: uint8, rounded to nearest (ties to even)."""
    # A product with 255 in a type of eight bits would be rounded twice.
    wide = images.detach().to(torch.promote_types(images.dtype, torch.float32))
    return (wide.clamp(0.0, 1.0) * 255).round().to(torch.uint8)


def quantize(images: Tensor) -> tuple[Tensor, Tensor]:
    """Images in [0,1], of any shape, as they are saved (uint8) and as a reader of the file sees them (float32)."""
    if images.dtype == torch.float32 and compiled.runs(images):
        plain = images.detach().contiguous()
        quantized, seen = torch.empty_like(plain, dtype=torch.uint8), torch.empty_like(plain)
        compiled.call("save", plain.dtype, plain.numel(), plain, quantized, seen, compiled.threads())
        return quantized, seen
    quantized = to_bytes(images)
    return quantized, from_bytes(quantized)


def from_bytes(images: Tensor) -> Tensor:
    """uint8 images as float32 in [0,1]."""
    return images.to(torch.float32) / 255


def as_saved(images: Tensor) -> Tensor:
    """What a reader of the saved file sees: rounded to 8 bits, float32."""
    return quantize(images)[1]
