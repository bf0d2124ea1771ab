"""AlexNet in its one-column form (Krizhevsky 2014), with the names and shapes of torchvision's state dict."""

from torch import Tensor, nn

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
