"""ResNet-34 trained on views of the furniture library."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.targets import furniture_networks
from services.targets.info import register

if TYPE_CHECKING:
    import torch

    from services.targets.protocol import Target

CARD = furniture_networks.card("resnet34-furniture", "ResNet-34")


@register(CARD, lambda: furniture_networks.labels(CARD.name))
def load(dtype: torch.dtype) -> Target:
    """Loads the network with the weights that ship with the project, frozen."""
    from services.targets.networks.resnet import ResNet

    return furniture_networks.load(CARD, ResNet(CARD.classes), dtype)
