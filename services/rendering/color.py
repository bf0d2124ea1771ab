"""Converts linear radiance to displayed values (sRGB), and displayed values to 8 bits."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from services.rendering.kernels import compiled

KNEE = 0.0031308
"""Linear value up to which the sRGB curve is a straight line (IEC 61966-2-1)."""


def to_display(linear: Tensor) -> Tensor:
    """Applies the sRGB curve (IEC 61966-2-1) to radiance of any shape, clipped to [0,1].

    It is differentiable (once); gradients are finite everywhere, and zero where values are clipped.
    """
    result: Tensor = _Display.apply(linear)  # type: ignore[no-untyped-call]
    return result


def display_derivative(linear: Tensor) -> Tensor:
    """Returns the derivative of `to_display`, of the same shape."""
    # The power is evaluated above the knee only, as its derivative at 0 is infinite.
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
        # Computed by way of the logarithm: the last bits of torch's power in float32 depend on an element's position in
        # the tensor, so an image's bits would depend on its batch.
        curved = 1.055 * (clipped.clamp_min(KNEE).log() / 2.4).exp() - 0.055
        return torch.where(clipped <= KNEE, 12.92 * clipped, curved)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_output: Tensor) -> Tensor:
        return grad_output * display_derivative(*ctx.saved_tensors)


def to_bytes(images: Tensor) -> Tensor:
    """Rounds images in [0,1], of any shape, to uint8 (to nearest, ties to even)."""
    # In a 16-bit float type the product with 255 would be rounded itself, so values would be rounded twice.
    wide = images.detach().to(torch.promote_types(images.dtype, torch.float32))
    return (wide.clamp(0.0, 1.0) * 255).round().to(torch.uint8)


def quantize(images: Tensor) -> tuple[Tensor, Tensor]:
    """Rounds images in [0,1], of any shape, to 8 bits; returns them as uint8 and as float32 multiples of 1/255."""
    if images.dtype == torch.float32 and compiled.runs(images):
        plain = images.detach().contiguous()
        quantized, seen = torch.empty_like(plain, dtype=torch.uint8), torch.empty_like(plain)
        compiled.call("save", plain.dtype, plain.numel(), plain, quantized, seen, compiled.threads())
        return quantized, seen
    quantized = to_bytes(images)
    return quantized, from_bytes(quantized)


def from_bytes(images: Tensor) -> Tensor:
    """Converts uint8 images to float32 in [0,1]."""
    return images.to(torch.float32) / 255


def as_saved(images: Tensor) -> Tensor:
    """Rounds images in [0,1] to 8 bits; returns float32 multiples of 1/255, as read back from a saved file."""
    return quantize(images)[1]
