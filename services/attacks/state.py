"""The state of a running attack: its trace, its verdicts and the perturbation that the result will store."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from services.attacks.trace import TraceRow
from services.rendering.protocol import Parameters


@dataclass
class AttackState:
    """The loop's state. Together with the method's state it is enough to resume the attack."""

    step: int = 0
    restart: int = 0
    """Number of the present start."""
    began: int = 0
    """The step at which it began."""
    trace: list[TraceRow] = field(default_factory=list)
    settings: dict[str, object] = field(default_factory=dict)
    ever: Tensor = field(default_factory=lambda: torch.zeros(0, 0, dtype=torch.bool))
    """Pixels that were ever truncated, bool [H, W]."""
    below_noise: int = 0
    """The number that `Method.advance` returned last."""
    seconds: float = 0.0
    stopped: str = ""
    fooled: bool = False
    verified: bool = False
    stored_step: int = 0
    sampled_error: tuple[float, float] | None = None
    """The renderer's `sampled_error` until the last checkpoint, mean and share."""
    stored: Parameters = field(default_factory=dict)
    """The perturbation to store: the verified one, else the last that met the goal inside the loop, else the one
    with the smallest advantage."""
    image: Tensor = field(default_factory=lambda: torch.zeros(0, 0, 3, dtype=torch.uint8))
    """The loop's image of the stored perturbation, truncated and rounded, uint8 [H, W, 3]."""
    scores: Tensor = field(default_factory=lambda: torch.zeros(0))
    """The network's scores of that image, [K]."""
