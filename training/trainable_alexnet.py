"""AlexNet as it is trained: batch normalisation after each layer, and hidden matrices of low rank.

Without normalisation AlexNet learns slowly, and its hidden matrices hold 54 of its 57 million weights. After training
the normalisation is folded into the layers and each pair of factors multiplied out, which gives AlexNet itself.
"""

import torch
from torch import Tensor, nn

from services.targets.networks.alexnet import CHANNELS, GRID, HIDDEN

RANK = 256
"""Rank of the hidden matrices."""
CONVOLUTIONS = ((0, 3, 64, 11, 4, 2), (3, 64, 192, 5, 1, 2), (6, 192, 384, 3, 1, 1), (8, 384, CHANNELS, 3, 1, 1))
LAST = (10, CHANNELS, CHANNELS, 3, 1, 1)
"""Number in torchvision's sequence, input and output channels, kernel, stride and padding of each convolution."""
POOLED = (0, 3, 10)
"""Convolutions that max pooling follows."""
HIDDEN_LAYERS = (1, 4)
OUTPUT_LAYER = 6
"""Numbers of the linear layers in torchvision's sequence."""


class Hidden(nn.Module):
    """A hidden layer: dropout, a matrix as the product of two, normalisation, ReLU."""

    def __init__(self, inputs: int, dropout: float, rank: int):
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.right = nn.Linear(inputs, rank, bias=False)
        self.left = nn.Linear(rank, HIDDEN, bias=False)
        self.norm = nn.BatchNorm1d(HIDDEN)

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, inputs] to [B, HIDDEN]."""
        y: Tensor = self.norm(self.left(self.right(self.dropout(x))))
        return y.relu_()


class TrainableAlexNet(nn.Module):
    """Normalised images [B, 3, h, w] to logits [B, classes]; `folded` gives the weights of AlexNet."""

    def __init__(self, classes: int, dropout: float, rank: int = RANK):
        super().__init__()
        layers: list[nn.Module] = []
        for number, inputs, outputs, kernel, stride, padding in (*CONVOLUTIONS, LAST):
            convolution = nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=False)
            nn.init.kaiming_normal_(convolution.weight, mode="fan_out", nonlinearity="relu")
            layers += [convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)]
            if number in POOLED:
                layers.append(nn.MaxPool2d(3, 2))
        self.features = nn.Sequential(*layers)
        self.avgpool = nn.AdaptiveAvgPool2d(GRID)
        self.hidden = nn.Sequential(Hidden(CHANNELS * GRID[0] * GRID[1], dropout, rank), Hidden(HIDDEN, dropout, rank))
        self.output = nn.Linear(HIDDEN, classes)

    def forward(self, x: Tensor) -> Tensor:
        """Maps normalised images [B, 3, h, w] to logits [B, classes]."""
        logits: Tensor = self.output(self.hidden(self.avgpool(self.features(x)).flatten(1)))
        return logits

    @torch.no_grad()
    def folded(self) -> dict[str, Tensor]:
        """Returns AlexNet's weights under torchvision's names, float32.

        A hidden matrix is a pair of factors: `<name>.left` [HIDDEN, rank] times `<name>.right` [rank, inputs].
        """
        state = {}
        convolutions = [layer for layer in self.features if isinstance(layer, nn.Conv2d)]
        norms = [layer for layer in self.features if isinstance(layer, nn.BatchNorm2d)]
        for (number, *_), convolution, norm in zip((*CONVOLUTIONS, LAST), convolutions, norms, strict=True):
            scale, shift = _affine(norm)
            state[f"features.{number}.weight"] = convolution.weight.double() * scale[:, None, None, None]
            state[f"features.{number}.bias"] = shift
        for number, hidden in zip(HIDDEN_LAYERS, self.hidden, strict=True):
            assert isinstance(hidden, Hidden)
            scale, shift = _affine(hidden.norm)
            state[f"classifier.{number}.weight.left"] = hidden.left.weight.double() * scale[:, None]
            state[f"classifier.{number}.weight.right"] = hidden.right.weight
            state[f"classifier.{number}.bias"] = shift
        state[f"classifier.{OUTPUT_LAYER}.weight"] = self.output.weight
        state[f"classifier.{OUTPUT_LAYER}.bias"] = self.output.bias
        return {name: value.detach().float().contiguous() for name, value in state.items()}


def _affine(norm: nn.BatchNorm1d | nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Returns the scale and the shift of a normalisation in evaluation, float64."""
    assert norm.running_var is not None
    assert norm.running_mean is not None
    scale = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
    return scale, norm.bias.double() - norm.running_mean.double() * scale
