"""Wraps torch's operators for oneDNN convolutions with weights reordered in advance.

These operators are private: torch's inductor compiles frozen networks to them, and a version may rename them. No public
method is as fast: `nn.Conv2d` reorders the weights in every call and needs another pass over memory for the activation,
`torch.utils.mkldnn` has no derivatives, and `torch.compile` generates the same operators after half a minute of
compilation. They are named in this file only; `packing` compares layers that use them with plain layers before a
network uses them.
"""

import torch
from torch import Tensor

Pair = tuple[int, ...]


def available() -> bool:
    """Returns whether this version of torch has oneDNN and both operators."""
    return (
        torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
        and hasattr(torch._C._nn, "mkldnn_reorder_conv2d_weight")
        and hasattr(torch.ops.mkldnn, "_convolution_pointwise")
    )


def lay_out(weight: Tensor, padding: Pair, stride: Pair, dilation: Pair, groups: int, size: Pair) -> Tensor:
    """Reorders weights [outputs, inputs / groups, kh, kw], float32 on the CPU, for `convolve` on inputs of `size`."""
    inputs = [1, weight.shape[1] * groups, *size]
    plain = weight.contiguous(memory_format=torch.channels_last).to_mkldnn()
    found: Tensor = torch._C._nn.mkldnn_reorder_conv2d_weight(  # type: ignore[call-arg]
        plain, list(padding), list(stride), list(dilation), groups, inputs
    )
    return found


def convolve(
    x: Tensor,
    weight: Tensor,
    bias: Tensor | None,
    padding: Pair,
    stride: Pair,
    dilation: Pair,
    groups: int,
    clamp: tuple[float, float] | None = None,
) -> Tensor:
    """Convolves x [B, inputs, h, w] with weights from `lay_out`; clamps the result to `clamp` if it is not None."""
    activation = ("none", (), "") if clamp is None else ("hardtanh", clamp, "")
    found: Tensor = torch.ops.mkldnn._convolution_pointwise(
        x, weight, bias, list(padding), list(stride), list(dilation), groups, *activation
    )
    return found
