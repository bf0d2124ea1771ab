"""oneDNN's convolution with weights laid out beforehand, by torch's own operators.

These operators are private: torch's inductor compiles frozen networks to them, and a version may rename them. No public
way has their speed: `nn.Conv2d` lays the weights out anew in every call and makes a pass over memory for the
activation, `torch.utils.mkldnn` has no derivatives, and `torch.compile` ends in the same operators after compiling for
half a minute. They are named in this file only; `packing` compares layers made of them with plain ones before a network
gets them.
"""

import torch
from torch import Tensor

Pair = tuple[int, ...]


def available() -> bool:
    """Whether this torch has oneDNN and both operators."""
    return (
        torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
        and hasattr(torch._C._nn, "mkldnn_reorder_conv2d_weight")
        and hasattr(torch.ops.mkldnn, "_convolution_pointwise")
    )


def lay_out(weight: Tensor, padding: Pair, stride: Pair, dilation: Pair, groups: int, size: Pair) -> Tensor:
    """Weights [outputs, inputs / groups, kh, kw], float32 on the CPU, as `convolve` takes them for inputs of `size`."""
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
    """The convolution of x [B, inputs, h, w] with weights from `lay_out`, held within `clamp` where there is one."""
    activation = ("none", (), "") if clamp is None else ("hardtanh", clamp, "")
    found: Tensor = torch.ops.mkldnn._convolution_pointwise(
        x, weight, bias, list(padding), list(stride), list(dilation), groups, *activation
    )
    return found
