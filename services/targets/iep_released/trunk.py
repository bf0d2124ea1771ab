"""The trunk: ResNet-101 (He et al. 2016) up to its third stage, with the names of torchvision's state dict."""

from collections.abc import Sequence

from torch import Tensor, nn

EXPANSION = 4
"""Outputs of a block for each channel of its 3×3 convolution."""
STAGES = 3


class Bottleneck(nn.Module):
    """A 1×1, a 3×3 and a 1×1 convolution beside a shortcut, which is a 1×1 convolution where the shapes differ."""

    def __init__(self, inputs: int, width: int, stride: int):
        super().__init__()
        outputs = EXPANSION * width
        self.conv1 = nn.Conv2d(inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Sequential | None = None
        if stride != 1 or inputs != outputs:
            shortcut = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, inputs, h, w] to [B, 4 width, h / stride, w / stride]."""
        shortcut = x if self.downsample is None else self.downsample(x)
        y = self.bn1(self.conv1(x)).relu()
        y = self.bn2(self.conv2(y)).relu()
        y = self.bn3(self.conv3(y))
        return (y + shortcut).relu()  # type: ignore[no-any-return]


class Trunk(nn.Module):
    """Maps normalised images [B, 3, h, w] to features [B, 16 width, h / 16, w / 16].

    width: channels of the first stage, 64 of ResNet-101. blocks: of each of the three stages, 3, 4 and 23.
    """

    def __init__(self, width: int, blocks: Sequence[int]):
        super().__init__()
        self.conv1 = nn.Conv2d(3, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = _stage(width, width, blocks[0], 1)
        self.layer2 = _stage(EXPANSION * width, 2 * width, blocks[1], 2)
        self.layer3 = _stage(2 * EXPANSION * width, 4 * width, blocks[2], 2)

    def forward(self, x: Tensor) -> Tensor:
        """Maps normalised images to features."""
        x = self.maxpool(self.bn1(self.conv1(x)).relu())
        return self.layer3(self.layer2(self.layer1(x)))  # type: ignore[no-any-return]


def _stage(inputs: int, width: int, blocks: int, stride: int) -> nn.Sequential:
    rest = (Bottleneck(EXPANSION * width, width, 1) for _ in range(blocks - 1))
    return nn.Sequential(Bottleneck(inputs, width, stride), *rest)
