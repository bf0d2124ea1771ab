"""The architectures of published and of trained networks, as plain torch modules.

AlexNet is that of one column (Krizhevsky 2014), ResNet-34 that of He et al. 2016; both have the names and shapes of
torchvision's state dicts. EfficientNet-Lite (Tan & Le 2019, the Lite variants of 2020) is a plain stack of
convolutions: batch normalisation is folded into them when the weights are loaded. In evaluation it is an affine map,
and folding it (in float64) saves a third of the memory traffic.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn
from torch.nn import functional as F

HIDDEN = 4096
"""Features of the two hidden layers."""
CHANNELS = 256
"""Channels of the last convolution."""
GRID = (6, 6)
"""Rows and columns to which the last feature maps are averaged (or repeated), so that images may have any size."""


class AlexNet(nn.Module):
    """The network: normalised images [B, 3, h, w], h and w at least 63 pixels, to logits [B, classes]."""

    def __init__(self, classes: int = 1000, dropout: float = 0.5):
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(3, 64, 11, stride=4, padding=2),
            nn.ReLU(inplace=True),
            nn.MaxPool2d(3, 2),
            nn.Conv2d(64, 192, 5, padding=2),
            nn.ReLU(inplace=True),
            nn.MaxPool2d(3, 2),
            nn.Conv2d(192, 384, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(384, CHANNELS, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(CHANNELS, CHANNELS, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.MaxPool2d(3, 2),
        )
        self.avgpool = nn.AdaptiveAvgPool2d(GRID)
        self.classifier = nn.Sequential(
            nn.Dropout(dropout),
            nn.Linear(CHANNELS * GRID[0] * GRID[1], HIDDEN),
            nn.ReLU(inplace=True),
            nn.Dropout(dropout),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(inplace=True),
            nn.Linear(HIDDEN, classes),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Maps normalised images [B, 3, h, w] to logits [B, classes]."""
        logits: Tensor = self.classifier(self.avgpool(self.features(x)).flatten(1))
        return logits


RESNET34 = (3, 4, 6, 3)
"""Blocks of the four stages of ResNet-34."""


class BasicBlock(nn.Module):
    """Two 3×3 convolutions beside a shortcut; the shortcut is a 1×1 convolution where the shapes differ."""

    def __init__(self, inputs: int, outputs: int, stride: int):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.relu = nn.ReLU(inplace=True)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Sequential | None = None
        if stride != 1 or inputs != outputs:
            shortcut = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, inputs, h, w] to [B, outputs, h / stride, w / stride]."""
        shortcut = x if self.downsample is None else self.downsample(x)
        y: Tensor = self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x)))))
        return self.relu(y + shortcut)  # type: ignore[no-any-return]


class ResNet(nn.Module):
    """The network: normalised images [B, 3, h, w] to logits [B, classes]."""

    def __init__(self, classes: int = 1000, stages: tuple[int, ...] = RESNET34):
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = _stage(64, 64, stages[0], 1)
        self.layer2 = _stage(64, 128, stages[1], 2)
        self.layer3 = _stage(128, 256, stages[2], 2)
        self.layer4 = _stage(256, 512, stages[3], 2)
        self.avgpool = nn.AdaptiveAvgPool2d((1, 1))
        self.fc = nn.Linear(512, classes)

    def pooled(self, x: Tensor) -> Tensor:
        """Maps normalised images [B, 3, h, w] to the features [B, 512] that the last layer classifies."""
        x = self.maxpool(self.relu(self.bn1(self.conv1(x))))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        return self.avgpool(x).flatten(1)  # type: ignore[no-any-return]

    def forward(self, x: Tensor) -> Tensor:
        """Maps normalised images [B, 3, h, w] to logits [B, classes]."""
        logits: Tensor = self.fc(self.pooled(x))
        return logits


def _stage(inputs: int, outputs: int, blocks: int, stride: int) -> nn.Sequential:
    rest = (BasicBlock(outputs, outputs, 1) for _ in range(blocks - 1))
    return nn.Sequential(BasicBlock(inputs, outputs, stride), *rest)


EPSILON = 1e-3
"""Epsilon of the batch normalisation."""

LITE0 = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
"""Stages of EfficientNet-Lite0: (repeats, kernel, stride of the first block, expansion, output channels)."""


class SameConv2d(nn.Conv2d):
    """`nn.Conv2d` with TensorFlow's SAME padding: its output has ⌈size / stride⌉ rows and columns; an odd row or column
    of zeros comes last.
    """

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
        margins = []
        for length, kernel, stride in zip(size, self.kernel_size, self.stride, strict=True):
            total = max((-(-length // stride) - 1) * stride + kernel - length, 0)
            margins.append((total // 2, total - total // 2))
        return margins[0], margins[1]


class Convolution(nn.Sequential):
    """A convolution with SAME padding and a bias, and optionally ReLU6."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1, relu: bool = True):
        convolution = SameConv2d(inputs, outputs, kernel, stride=stride, groups=groups)
        super().__init__(convolution, *([nn.ReLU6()] if relu else []))


@dataclass(frozen=True)
class _Shape:
    inputs: int
    outputs: int
    kernel: int
    stride: int
    expansion: int


class Block(nn.Module):
    """An inverted residual block: expand, depthwise, project; added to its input if the shapes are equal."""

    def __init__(self, shape: _Shape):
        super().__init__()
        wide = shape.inputs * shape.expansion
        self.expand = Convolution(shape.inputs, wide, 1) if shape.expansion != 1 else None
        self.depthwise = Convolution(wide, wide, shape.kernel, shape.stride, groups=wide)
        self.project = Convolution(wide, shape.outputs, 1, relu=False)
        self.residual = shape.stride == 1 and shape.inputs == shape.outputs

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, inputs, h, w] to [B, outputs, h', w']."""
        y: Tensor = x if self.expand is None else self.expand(x)
        y = self.project(self.depthwise(y))
        return x + y if self.residual else y


class EfficientNetLite(nn.Module):
    """The network: normalised images [B, 3, h, w] to logits [B, classes]."""

    def __init__(self, stages: tuple[tuple[int, int, int, int, int], ...] = LITE0, classes: int = 1000):
        super().__init__()
        self.stem = Convolution(3, 32, 3, 2)
        blocks, channels = [], 32
        for repeats, kernel, stride, expansion, outputs in stages:
            for repeat in range(repeats):
                blocks.append(Block(_Shape(channels, outputs, kernel, stride if repeat == 0 else 1, expansion)))
                channels = outputs
        self.blocks = nn.Sequential(*blocks)
        self.head = Convolution(channels, 1280, 1)
        self.classifier = nn.Linear(1280, classes)

    def forward(self, x: Tensor) -> Tensor:
        """Maps normalised images [B, 3, h, w] to logits [B, classes]."""
        logits: Tensor = self.classifier(self.head(self.blocks(self.stem(x))).mean(dim=(2, 3)))
        return logits

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        """Loads weights under their published names. Raises KeyError if a weight is missing."""
        _fold(self.stem, state, "_conv_stem", "_bn0")
        for index, block in enumerate(self.blocks):
            assert isinstance(block, Block)
            prefix = f"_blocks.{index}."
            if block.expand is not None:
                _fold(block.expand, state, f"{prefix}_expand_conv", f"{prefix}_bn0")
            _fold(block.depthwise, state, f"{prefix}_depthwise_conv", f"{prefix}_bn1")
            _fold(block.project, state, f"{prefix}_project_conv", f"{prefix}_bn2")
        _fold(self.head, state, "_conv_head", "_bn1")
        self.classifier.weight.data.copy_(state["_fc.weight"])
        self.classifier.bias.data.copy_(state["_fc.bias"])
        self.requires_grad_(False)


def _fold(block: Convolution, state: Mapping[str, Tensor], name: str, norm: str) -> None:
    convolution = block[0]
    assert isinstance(convolution, SameConv2d)
    assert convolution.bias is not None
    mean, variance = state[f"{norm}.running_mean"].double(), state[f"{norm}.running_var"].double()
    scale = state[f"{norm}.weight"].double() / (variance + EPSILON).sqrt()
    convolution.weight.data.copy_(state[f"{name}.weight"].double() * scale[:, None, None, None])
    convolution.bias.data.copy_(state[f"{norm}.bias"].double() - mean * scale)
