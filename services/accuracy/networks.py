"""A network small enough to know everything about, through the classifier that published ones go through."""

import torch
from torch import nn

from services.targets.classifier import Classifier

SIDE = 8


def linear_network(
    scale: float = 1.0, classes: int = 4, lead: float = 0.0, dtype: torch.dtype = torch.float32
) -> Classifier:
    """Scores that are linear in the pixels of an 8×8 picture, times `scale`; the same weights every time.

    The first label has `lead` more than that: so much that nothing that is shown can change the answer.
    """
    layer = nn.Linear(3 * SIDE * SIDE, classes).requires_grad_(False)
    random = torch.Generator().manual_seed(11)
    layer.weight.copy_(scale * torch.randn(layer.weight.shape, generator=random) / SIDE)
    layer.bias.copy_(scale * torch.randn(layer.bias.shape, generator=random))
    layer.bias[0] += lead
    return Classifier(
        name="linear",
        network=nn.Sequential(nn.Flatten(), layer),
        labels=tuple(f"label {k}" for k in range(classes)),
        input_size=(SIDE, SIDE),
        mean=(0.5, 0.5, 0.5),
        scale=(1.0, 1.0, 1.0),
        weights_sha256="0" * 64,
        dtype=dtype,
    )
