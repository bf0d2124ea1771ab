"""The convolutions of a frozen network as oneDNN runs them fastest: weights laid out once, the activation in the same
pass, and a derivative of their own.

Left to autograd, every call lays the weights out anew, ReLU6 is a pass over memory of its own, and an odd SAME padding
is a copy. A frozen network needs only the derivative with respect to the input, and that of a convolution with stride 1
is again such a convolution, with the kernel turned round. Pictures of one size are meant; others take the plain way.
"""

from functools import cached_property
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from services.targets.efficientnet_lite import Convolution

LAST = torch.channels_last


def packable(dtype: torch.dtype) -> bool:
    """Whether this torch has packed convolutions of a dtype."""
    return dtype == torch.float32 and torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]


@torch.no_grad()
def pack(network: nn.Module, size: tuple[int, int]) -> None:
    """Replaces the convolutions of a float32 network on the CPU by packed ones, for pictures of `size` (height, width).

    Logits and gradients stay the same but for rounding.
    """
    sizes: dict[nn.Module, tuple[int, int]] = {}

    def note(convolution: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:  # noqa: ARG001 - torch's
        sizes[convolution] = (inputs[0].shape[2], inputs[0].shape[3])

    parents = [
        (parent, name, child)
        for parent in network.modules()
        for name, child in parent.named_children()
        if isinstance(child, Convolution)
    ]
    hooks = [child.register_forward_hook(note) for _, _, child in parents]
    network(torch.zeros(1, 3, *size).contiguous(memory_format=LAST))
    for hook in hooks:
        hook.remove()
    for parent, name, child in parents:
        setattr(parent, name, PackedConvolution(child, sizes[child]))


class PackedConvolution(nn.Module):
    """A `Convolution` for inputs [B, channels, *size], any B."""

    def __init__(self, plain: Convolution, size: tuple[int, int]) -> None:
        super().__init__()
        self.plain, self.size = plain, size
        self.stride, self.groups, self.relu = plain.stride, plain.groups, plain.relu
        pad = plain.pad(size[0])
        if plain.pad(size[1]) != pad:
            raise ValueError(f"inputs of {size} are padded differently in height and width")
        # SAME puts an odd row and column behind; a row and a column of zeros before the kernel's own do the same.
        self.pad, self.padding = pad, (pad + 1) // 2
        self.weight = F.pad(plain.weight, (pad % 2, 0, pad % 2, 0))

    # Laid out when first needed: a process that only asks for scores never needs the turned kernels.
    @cached_property
    def packed(self) -> Tensor:
        """The weights as `convolve` takes them."""
        return self._pack(self.weight, self.padding, self.stride)

    @cached_property
    def turned(self) -> Tensor:
        """The weights turned round, as `turn` takes them; for stride 1."""
        turned = self.weight.flip(2, 3)
        return self._pack(turned if self.groups > 1 else turned.transpose(0, 1), self.pad - self.padding, 1)

    def _pack(self, weight: Tensor, padding: int, stride: int) -> Tensor:
        inputs = [1, weight.shape[1] * self.groups, *self.size]
        layout: Tensor = torch._C._nn.mkldnn_reorder_conv2d_weight(  # type: ignore[call-arg]
            weight.contiguous(memory_format=LAST).to_mkldnn(), [padding] * 2, [stride] * 2, [1, 1], self.groups, inputs
        )
        return layout

    def forward(self, x: Tensor) -> Tensor:
        """[B, inputs, h, w] to [B, outputs, ⌈h/stride⌉, ⌈w/stride⌉]."""
        if tuple(x.shape[2:]) != self.size or x.dtype != torch.float32:
            return self.plain(x)  # type: ignore[no-any-return]
        result: Tensor = _Convolve.apply(x, self)  # type: ignore[no-untyped-call]
        return result

    def convolve(self, x: Tensor) -> Tensor:
        """The result, with its activation."""
        return self._run(x, self.packed, self.plain.bias, self.padding, self.stride, self.relu)

    def turn(self, slope: Tensor) -> Tensor:
        """∂/∂input from ∂/∂output, of the convolution without its activation."""
        if self.stride == 1:
            return self._run(slope, self.turned, None, self.pad - self.padding, 1, relu=False)
        height, width = self.size
        shape = (len(slope), self.plain.weight.shape[1] * self.groups, height + self.pad, width + self.pad)
        inputs = torch.empty(shape, memory_format=LAST)  # only its shape and layout are looked at
        padded: Tensor = torch.ops.aten.convolution_backward(
            slope, inputs, self.plain.weight, None, [self.stride] * 2, [0, 0], [1, 1], False, [0, 0],
            self.groups, [True, False, False],
        )[0]  # fmt: skip
        first = self.pad // 2
        return padded[:, :, first : first + height, first : first + width]

    def _run(self, x: Tensor, weight: Tensor, bias: Tensor | None, padding: int, stride: int, relu: bool) -> Tensor:
        activation = ("hardtanh", (0.0, 6.0), "") if relu else ("none", (), "")
        result: Tensor = torch.ops.mkldnn._convolution_pointwise(
            x, weight, bias, [padding] * 2, [stride] * 2, [1, 1], self.groups, *activation
        )
        return result


class _Convolve(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, convolution: PackedConvolution) -> Tensor:
        result = convolution.convolve(x)
        ctx.convolution = convolution
        if convolution.relu:
            ctx.save_for_backward(result)
        return result

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor, None]:
        if ctx.convolution.relu:
            slope = torch.ops.aten.hardtanh_backward(slope, *ctx.saved_tensors, 0.0, 6.0)
        return ctx.convolution.turn(slope), None
