"""The trunk: a small convolutional network from an image to the features that the modules read."""

from torch import Tensor, nn

IMAGE = (240, 320)
"""Height and width of the images, in pixels."""
STRIDE = 16
"""Pixels of a feature cell's side."""
GRID = (IMAGE[0] // STRIDE, IMAGE[1] // STRIDE)
CHANNELS = 96
MEAN, SCALE = 0.5, 0.25
"""Normalisation of pixel values in [0,1]."""


class Convolution(nn.Sequential):
    """A convolution that keeps the size or divides it by its stride, batch normalisation, and optionally ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1, relu: bool = True):
        convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        nn.init.kaiming_normal_(convolution.weight, mode="fan_out", nonlinearity="relu")
        super().__init__(convolution, nn.BatchNorm2d(outputs), *([nn.ReLU()] if relu else []))


class Block(nn.Module):
    """A residual block of two 3×3 convolutions."""

    def __init__(self, channels: int):
        super().__init__()
        self.first = Convolution(channels, channels, 3)
        self.second = Convolution(channels, channels, 3, relu=False)

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, channels, h, w] to the same shape."""
        y: Tensor = x + self.second(self.first(x))
        return y.relu()


class Trunk(nn.Module):
    """Maps images [B, 240, 320, 3] in [0,1] to features [B, 96, 15, 20]; 0.51 million parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            Convolution(3, 24, 5, 2),
            Convolution(24, 48, 3, 2),
            Block(48),
            Convolution(48, CHANNELS, 3, 2),
            Block(CHANNELS),
            Convolution(CHANNELS, CHANNELS, 3, 2),
            Block(CHANNELS),
        )

    def forward(self, images: Tensor) -> Tensor:
        """Maps images [B, 240, 320, 3] in [0,1] to features [B, 96, 15, 20]. Raises ValueError for another size."""
        if images.dim() != 4 or tuple(images.shape[1:]) != (*IMAGE, 3):
            raise ValueError(f"the trunk takes images [B, {IMAGE[0]}, {IMAGE[1]}, 3], not {list(images.shape)}")
        features: Tensor = self.layers((images.permute(0, 3, 1, 2) - MEAN) / SCALE)
        return features
