"""A network and an image small enough to know everything about, and the problem of attacking one with the other."""

from typing import Any

import torch
from torch import Tensor, nn

from services.attacks.goal import ResolvedGoal
from services.attacks.problem import AttackProblem
from services.rendering.image_renderer import ImageRenderer
from services.rendering.protocol import Renderer
from services.targets.classifier import Classifier

SIDE = 8
NEVER = 1e4
"""A lead of the first label that no image makes up for: such attacks run through all their steps."""


def linear_network(
    scale: float = 1.0, classes: int = 4, lead: float = 0.0, dtype: torch.dtype = torch.float32
) -> Classifier:
    """Scores that are linear in the pixels of an 8×8 image, times `scale`; the same weights every time.

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


def pixels() -> ImageRenderer:
    """An image of 8×8 random pixels, away from black and white."""
    random = torch.Generator().manual_seed(5)
    return ImageRenderer(0.2 + 0.6 * torch.rand(SIDE, SIDE, 3, generator=random), "random numbers")


def linear_problem(
    renderer: Renderer, groups: tuple[str, ...] | None = None, lead: float = NEVER, **more: Any
) -> AttackProblem:
    """To leave the first of the network's two labels; `groups` None: those it is compiled for."""
    network = linear_network(classes=2, lead=lead)
    return AttackProblem(renderer, network, ResolvedGoal((0,), None), groups or renderer.plan.groups, **more)


def linear_gradient() -> Tensor:
    """∂(z₀ − z₁)/∂pixel of the network with two classes, float64 [8, 8, 3]: a closed form for every difference."""
    weight = linear_network(classes=2).network.get_parameter("1.weight").double()
    return (weight[0] - weight[1]).reshape(3, SIDE, SIDE).permute(1, 2, 0)
