"""The stem of the engine: what all modules see of an image, and `scene`, the mask of all objects.

Modules work at the cells that are likeliest to hold an object, as no set has a member elsewhere. A cell's weight falls
to zero before it drops out, so scores are a continuous function of the image.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from services.targets.iep.modules import FIRST_MASK, WIDTH, Seen
from services.targets.iep.trunk import CHANNELS, GRID

N_CELLS = GRID[0] * GRID[1]


class Candidates(NamedTuple):
    """What the stem finds.

    scene: mask logits [B, 300] of all objects, at all cells. cells: int64 [B, P], the cells that modules work at.
    seen: what they see there. logits: [B, P], those of `scene` there.
    """

    scene: Tensor
    cells: Tensor
    seen: Seen
    logits: Tensor


class Stem(nn.Module):
    """Maps features [B, 96, 15, 20] to the P = `cells` cells likeliest to hold an object; 300 are all of them."""

    grid: Tensor

    def __init__(self, cells: int):
        super().__init__()
        if not 0 < cells <= N_CELLS:
            raise ValueError(f"the engine works at 1 to {N_CELLS} cells, not {cells}")
        self.cells = cells
        self.mask = nn.Conv1d(CHANNELS, 1, 1)
        self.looks = nn.Conv1d(CHANNELS, WIDTH, 1)
        nn.init.kaiming_normal_(self.looks.weight, nonlinearity="relu")
        nn.init.constant_(self.mask.bias, FIRST_MASK)  # type: ignore[arg-type]
        self.register_buffer("grid", coordinates(), persistent=False)

    def forward(self, features: Tensor) -> Candidates:
        """Returns the candidates of images with features [B, 96, 15, 20]."""
        features = features.flatten(2)
        scene = self.mask(features)[:, 0]
        if self.cells < N_CELLS:
            likeliest = scene.topk(self.cells + 1, dim=1)
            cells, logits = likeliest.indices[:, :-1], likeliest.values[:, :-1]
            gate = (logits - likeliest.values[:, -1:]).tanh()
            features = features.gather(2, cells[:, None].expand(-1, CHANNELS, -1))
        else:
            cells = torch.arange(N_CELLS, device=scene.device).expand(len(scene), -1)
            logits, gate = scene, torch.ones_like(scene)
        coordinates = self.grid[:, cells].transpose(0, 1)
        seen = torch.cat([self.looks(features).relu(), coordinates], dim=1)
        return Candidates(scene, cells, Seen(seen, gate), logits)


def coordinates() -> Tensor:
    """Returns horizontal and vertical coordinates [2, 300] of the cells' centres, in half widths of the image."""
    height, width = GRID
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([2 * x + 1 - width, 2 * y + 1 - height]).flatten(1).float() / width
