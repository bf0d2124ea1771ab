"""A convolution with TensorFlow's SAME padding."""

from typing import Any

from torch import Tensor, nn
from torch.nn import functional as F


class SameConv2d(nn.Conv2d):
    """`nn.Conv2d` whose output has ⌈size / stride⌉ rows and columns; an odd row or column of zeros comes last."""

    def __init__(self, inputs: int, outputs: int, kernel: int, **options: Any) -> None:
        """`options` are those of `nn.Conv2d`, except padding and dilation."""
        super().__init__(inputs, outputs, kernel, **options)

    def forward(self, input: Tensor) -> Tensor:  # noqa: A002 - torch's name
        """Maps [B, inputs, h, w] to [B, outputs, ⌈h/stride⌉, ⌈w/stride⌉]."""
        (top, bottom), (left, right) = self.zeros((input.shape[-2], input.shape[-1]))
        padding = (top, left)
        if (top, left) != (bottom, right):
            input, padding = F.pad(input, [left, right, top, bottom]), (0, 0)  # noqa: A001
        return F.conv2d(input, self.weight, self.bias, self.stride, padding, groups=self.groups)

    def zeros(self, size: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
        """Returns the padding of an input of `size` (height, width): (above, below) and (left, right)."""
        found = []
        for length, kernel, stride in zip(size, self.kernel_size, self.stride, strict=True):
            total = max((-(-length // stride) - 1) * stride + kernel - length, 0)
            found.append((total // 2, total - total // 2))
        return found[0], found[1]
