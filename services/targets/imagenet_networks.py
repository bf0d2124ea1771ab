"""AlexNet and ResNet-34 with torchvision's ImageNet-1k weights, fetched from their published addresses on first use.

The published files are pickles. They are read with `weights_only=True`: torch's restricted unpickler builds tensors and
containers and runs no code of the file; and the file's SHA-256 is compared with the published name first.

A whole view is resized to 224 × 224 (antialiased bilinear). torchvision crops the middle 224 of 256 pixels, which would
cut off objects that fill the frame.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from services.targets.architectures import register_architecture
from services.targets.info import Published, TargetInfo, register
from services.targets.labels import imagenet_labels

if TYPE_CHECKING:
    import torch
    from torch import nn

    from services.targets.protocol import Target

ADDRESS = "https://download.pytorch.org/models/"
ALEXNET_FILE, RESNET34_FILE = "alexnet-owt-7be5be79.pth", "resnet34-b627a593.pth"
"""Names of the weights files; they end in the first digits of the files' SHA-256."""
MEAN, SCALE = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""torchvision's normalisation."""


def _card(name: str, title: str, file: str) -> TargetInfo:
    return TargetInfo(
        name=name,
        title=f"{title}, ImageNet-1k",
        task="classification",
        input_size=(224, 224),
        classes=1000,
        differentiable=True,
        takes_question=False,
        source=ADDRESS + file,
        licence="BSD-3-Clause",
        vocabulary="imagenet",
    )


ALEXNET = _card("alexnet", "AlexNet", ALEXNET_FILE)
RESNET34 = _card("resnet34", "ResNet-34", RESNET34_FILE)


@register_architecture("alexnet")
def build_alexnet(classes: int) -> nn.Module:
    """Builds AlexNet without its weights, which have torchvision's names."""
    from services.targets.networks.alexnet import AlexNet

    return AlexNet(classes)


@register_architecture("resnet34")
def build_resnet34(classes: int) -> nn.Module:
    """Builds ResNet-34 without its weights, which have torchvision's names."""
    from services.targets.networks.resnet import ResNet

    return ResNet(classes)


@register(ALEXNET, imagenet_labels, Published(ALEXNET.source))
def alexnet(dtype: torch.dtype) -> Target:
    """Loads AlexNet, frozen. Raises InvalidRequest("target.name") if its weights cannot be fetched."""
    from services.targets.networks.alexnet import AlexNet

    return load_published(ALEXNET, AlexNet(), dtype)


@register(RESNET34, imagenet_labels, Published(RESNET34.source))
def resnet34(dtype: torch.dtype) -> Target:
    """Loads ResNet-34, frozen. Raises InvalidRequest("target.name") if its weights cannot be fetched."""
    from services.targets.networks.resnet import ResNet

    return load_published(RESNET34, ResNet(), dtype)


def load_published(card: TargetInfo, network: nn.Module, dtype: torch.dtype) -> Target:
    """Returns the target of a card whose `source` is the address of the weights; its name ends in their SHA-256.

    Raises InvalidRequest("target.name") if they cannot be fetched, and torch's errors for a file that is no state dict
    of the network.
    """
    import torch

    from services.targets.classifier import Classifier
    from services.targets.download import fetch

    weights = Published(card.source)
    path = fetch(weights, weights.path.parent)
    network.load_state_dict(torch.load(path, weights_only=True, map_location="cpu"))
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Classifier(
        name=card.name,
        network=network,
        labels=imagenet_labels(),
        input_size=card.input_size,
        mean=MEAN,
        scale=SCALE,
        weights_sha256=digest,
        dtype=dtype,
    )
