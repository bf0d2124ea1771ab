"""Defines the ONNX operators that slide a window over an image as torch functions: convolution and pools."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

Ints = Sequence[int]


def _same(lengths: Ints, kernel: Ints, strides: Ints, dilations: Ints, upper: bool) -> list[int]:
    """The padding [before of each axis, after of each axis] with which an output has ⌈length / stride⌉ values."""
    before, after = [], []
    for length, width, stride, dilation in zip(lengths, kernel, strides, dilations, strict=True):
        total = max((-(-length // stride) - 1) * stride + dilation * (width - 1) + 1 - length, 0)
        small, large = total // 2, total - total // 2
        before.append(small if upper else large)
        after.append(large if upper else small)
    return before + after


def _windows(
    x: Tensor, kernel: Ints, strides: Ints | None, dilations: Ints | None, pads: Ints | None, auto_pad: str
) -> tuple[list[int], list[int], list[int]]:
    """Strides, dilations and padding [top, left, bottom, right] of a sliding window over an image."""
    if len(kernel) != 2:
        raise ValueError(f"windows over {len(kernel)} axes are not converted, only over images")
    stride = list(strides or (1, 1))
    dilation = list(dilations or (1, 1))
    if auto_pad in ("SAME_UPPER", "SAME_LOWER"):
        return stride, dilation, _same(x.shape[2:], kernel, stride, dilation, auto_pad == "SAME_UPPER")
    return stride, dilation, list(pads or (0, 0, 0, 0))


def _padded(x: Tensor, padding: Ints, value: float) -> tuple[Tensor, tuple[int, int]]:
    """The image padded as far as the two sides differ, and the padding that is left, the same on both sides."""
    top, left, bottom, right = padding
    if (top, left) == (bottom, right):
        return x, (top, left)
    return F.pad(x, [left, right, top, bottom], value=value), (0, 0)


def conv(
    x: Tensor,
    weight: Tensor,
    bias: Tensor | None = None,
    *,
    auto_pad: str = "NOTSET",
    dilations: Ints | None = None,
    group: int = 1,
    kernel_shape: Ints | None = None,  # noqa: ARG001 - the weight says it too
    pads: Ints | None = None,
    strides: Ints | None = None,
) -> Tensor:
    """Convolves an image [B, C, h, w]."""
    stride, dilation, padding = _windows(x, weight.shape[2:], strides, dilations, pads, auto_pad)
    x, rest = _padded(x, padding, 0.0)
    return F.conv2d(x, weight, bias, stride, rest, dilation, group)


def max_pool(
    x: Tensor,
    *,
    kernel_shape: Ints,
    auto_pad: str = "NOTSET",
    ceil_mode: int = 0,
    dilations: Ints | None = None,
    pads: Ints | None = None,
    storage_order: int = 0,  # noqa: ARG001 - of indices, which are not returned
    strides: Ints | None = None,
) -> Tensor:
    """Returns the largest value of each window."""
    stride, dilation, padding = _windows(x, kernel_shape, strides, dilations, pads, auto_pad)
    x, rest = _padded(x, padding, -torch.inf)
    return F.max_pool2d(x, list(kernel_shape), stride, rest, dilation, bool(ceil_mode))


def average_pool(
    x: Tensor,
    *,
    kernel_shape: Ints,
    auto_pad: str = "NOTSET",
    ceil_mode: int = 0,
    count_include_pad: int = 0,
    pads: Ints | None = None,
    strides: Ints | None = None,
) -> Tensor:
    """Returns the mean of each window."""
    stride, _, padding = _windows(x, kernel_shape, strides, None, pads, auto_pad)
    if padding[:2] != padding[2:]:
        raise ValueError("AveragePool with padding that differs between sides is not converted")
    return F.avg_pool2d(x, list(kernel_shape), stride, padding[:2], bool(ceil_mode), bool(count_include_pad))
