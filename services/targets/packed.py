"""A frozen convolution with oneDNN: weights are reordered once, the activation is fused, the backward pass is its own.

Under autograd every call reorders the weights, an activation takes another pass over memory, and asymmetric padding
takes a copy. A frozen network needs only the derivative with respect to the input, and that of a convolution with
stride 1 is again a convolution with stride 1, with the kernel rotated by 180°.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.grad import conv2d_input

from services.targets import onednn
from services.targets.same_padding import SameConv2d

Pair = tuple[int, int]

ACTIVATIONS: dict[type[nn.Module], tuple[float, float]] = {nn.ReLU: (0.0, inf), nn.ReLU6: (0.0, 6.0)}
"""Range to which each activation clamps values; its derivative is 1 strictly inside, else 0."""


@dataclass(frozen=True)
class Padding:
    """Zero padding of an input: `after` rows and columns behind it, and `extra` (0 or 1) fewer before it."""

    after: Pair
    extra: Pair

    @classmethod
    def of(cls, convolution: nn.Conv2d, size: Pair) -> "Padding | None":
        """Returns the padding of an input of `size`; None if it is not of this form or not of zeros."""
        if convolution.padding_mode != "zeros":
            return None
        if isinstance(convolution, SameConv2d):
            zeros = convolution.zeros(size)
        elif isinstance(convolution.padding, str):
            spread = [d * (k - 1) for d, k in zip(convolution.dilation, convolution.kernel_size, strict=True)]
            both = [0, 0] if convolution.padding == "valid" else spread
            zeros = (both[0] // 2, both[0] - both[0] // 2), (both[1] // 2, both[1] - both[1] // 2)
        else:
            zeros = tuple((amount, amount) for amount in convolution.padding)  # type: ignore[assignment]
        (top, bottom), (left, right) = zeros
        extra = (bottom - top, right - left)
        if any(extra) and convolution.dilation != (1, 1):  # the row of zeros added to the kernel would be dilated
            return None
        return cls((bottom, right), extra)


class PackedConvolution(nn.Module):
    """A frozen `nn.Conv2d` fused with the activation that follows it, for inputs [B, channels, *size], any B.

    Inputs of another size, dtype or device are passed to `plain`.
    """

    def __init__(
        self, convolution: nn.Conv2d, padding: Padding, activation: nn.Module | None, plain: nn.Module, size: Pair
    ) -> None:
        super().__init__()
        self.plain, self.size = plain, size
        self.clamp = None if activation is None else ACTIVATIONS[type(activation)]
        self.stride, self.dilation, self.groups = convolution.stride, convolution.dilation, convolution.groups
        self.padding, self.bias = padding.after, convolution.bias
        self.weight = convolution.weight.detach()
        if any(padding.extra):
            # The padding before the input is `extra` rows smaller; zeros before the kernel's rows compensate it.
            self.weight = F.pad(self.weight, (padding.extra[1], 0, padding.extra[0], 0))

    # Reordered when first needed: a process that only computes scores never needs the rotated kernels.
    @cached_property
    def packed(self) -> Tensor:
        """The weights reordered for `convolve`."""
        return onednn.lay_out(self.weight, self.padding, self.stride, self.dilation, self.groups, self.size)

    @cached_property
    def turned(self) -> Callable[[Tensor], Tensor]:
        """A function from ∂/∂output to ∂/∂input of the convolution without its activation."""
        back = [d * (k - 1) - p for d, k, p in zip(self.dilation, self.weight.shape[2:], self.padding, strict=True)]
        if self.stride != (1, 1) or min(back) < 0:
            return self._derivative
        padding = (back[0], back[1])
        outputs, inputs, *kernel = self.weight.shape
        by_group = self.weight.flip(2, 3).reshape(self.groups, outputs // self.groups, inputs, *kernel)
        turned = by_group.transpose(1, 2).reshape(self.groups * inputs, outputs // self.groups, *kernel)
        size = [
            n + 2 * p - d * (k - 1) for n, p, d, k in zip(self.size, self.padding, self.dilation, kernel, strict=True)
        ]
        weight = onednn.lay_out(turned, padding, (1, 1), self.dilation, self.groups, (size[0], size[1]))
        return lambda grad_output: onednn.convolve(
            grad_output, weight, None, padding, (1, 1), self.dilation, self.groups
        )

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, inputs, h, w] to [B, outputs, h', w']."""
        if tuple(x.shape[2:]) != self.size or x.dtype != torch.float32 or x.device.type != "cpu":
            return self.plain(x)  # type: ignore[no-any-return]
        result: Tensor = _Convolve.apply(x, self)  # type: ignore[no-untyped-call]
        return result

    def convolve(self, x: Tensor) -> Tensor:
        """Returns the convolution of x with the activation applied."""
        of = (self.padding, self.stride, self.dilation, self.groups)
        return onednn.convolve(x, self.packed, self.bias, *of, self.clamp)

    def _derivative(self, grad_output: Tensor) -> Tensor:
        shape = (len(grad_output), self.weight.shape[1] * self.groups, *self.size)
        of = (self.stride, self.padding, self.dilation, self.groups)
        found: Tensor = conv2d_input(shape, self.weight, grad_output, *of)  # type: ignore[no-untyped-call]
        return found


class _Convolve(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, convolution: PackedConvolution) -> Tensor:
        result = convolution.convolve(x)
        ctx.convolution = convolution
        if convolution.clamp is not None:
            ctx.save_for_backward(result)
        return result

    @staticmethod
    def backward(ctx: Any, grad_output: Tensor) -> tuple[Tensor, None]:
        convolution: PackedConvolution = ctx.convolution
        if convolution.clamp is not None:
            grad_output = torch.ops.aten.hardtanh_backward(grad_output, *ctx.saved_tensors, *convolution.clamp)
        return convolution.turned(grad_output), None
