"""AlexNet and ResNet-34 trained on views of the furniture library; see docs/reports/training.md."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from services.targets.info import TargetInfo, register

if TYPE_CHECKING:
    import torch
    from torch import nn

    from services.targets.protocol import Target


@cache
def facts(name: str) -> dict[str, Any]:
    """Returns the record that lies beside a network's weights: labels, input, training, held-out accuracy."""
    content: dict[str, Any] = json.loads(_path(name, "json").read_text("utf-8"))
    return content


def labels(name: str) -> tuple[str, ...]:
    """Returns a network's labels, which are kinds of furniture."""
    return tuple(facts(name)["labels"])


def card(name: str, title: str) -> TargetInfo:
    """Returns a network's card."""
    recorded = facts(name)
    height, width = recorded["input_size"]
    return TargetInfo(
        name=name,
        title=f"{title}, {len(recorded['labels'])} kinds of furniture",
        task="classification",
        input_size=(height, width),
        classes=len(recorded["labels"]),
        differentiable=True,
        takes_question=False,
        source=f"trained by this project: {recorded['command']}",
        licence="Apache-2.0",
        vocabulary="furniture-14",
    )


def load(info: TargetInfo, network: nn.Module, dtype: torch.dtype) -> Target:
    """Returns the target of a card, with the weights that ship with the project in `network`, frozen."""
    from services.targets.classifier import Classifier
    from services.targets.weights_file import load_in_factors

    path, recorded = _path(info.name, "safetensors"), facts(info.name)
    load_in_factors(network, path)
    return Classifier(
        name=info.name,
        network=network,
        labels=labels(info.name),
        input_size=info.input_size,
        mean=tuple(recorded["mean"]),
        scale=tuple(recorded["scale"]),
        weights_sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        dtype=dtype,
    )


def _path(name: str, ending: str) -> Path:
    return Path(str(files("services.targets").joinpath("weights"))) / f"{name}.{ending}"


ALEXNET = card("alexnet-furniture", "AlexNet")
RESNET34 = card("resnet34-furniture", "ResNet-34")


@register(ALEXNET, lambda: labels(ALEXNET.name))
def alexnet(dtype: torch.dtype) -> Target:
    """Loads AlexNet with the weights that ship with the project, frozen."""
    from services.targets.networks.alexnet import AlexNet

    return load(ALEXNET, AlexNet(ALEXNET.classes), dtype)


@register(RESNET34, lambda: labels(RESNET34.name))
def resnet34(dtype: torch.dtype) -> Target:
    """Loads ResNet-34 with the weights that ship with the project, frozen."""
    from services.targets.networks.resnet import ResNet

    return load(RESNET34, ResNet(RESNET34.classes), dtype)
