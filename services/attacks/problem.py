"""An attack's problem: a renderer, a network, a goal; and the count of everything asked of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from services.attacks.goal import ResolvedGoal
from services.errors import JobFailure
from services.rendering.protocol import Parameters, Renderer
from services.targets.protocol import Target

ROUNDING = 1e-6
"""A pixel at exactly U is not beyond it; float32 sums of k/255 are off by less than this."""


@dataclass(frozen=True)
class View:
    """What the loop sees at one perturbation. Images [1, H, W, 3]."""

    perturbation: Parameters
    """The perturbation seen; leaves of the graph of `images` if a gradient was asked for."""
    images: Tensor
    """The float picture, truncated where U asks."""
    truncated: Tensor
    """Pixels held back, bool [H, W]."""


@dataclass
class Problem:
    """Renders perturbations and puts pictures to the network, counting both.

    `truncation` is U in [0,1] or None; `weight` is λ of the summed squares of the picture's change (zoo).
    """

    renderer: Renderer
    target: Target
    goal: ResolvedGoal
    groups: tuple[str, ...]
    seed: int = 0
    question: str | None = None
    truncation: float | None = None
    weight: float = 0.0
    interrupt: Callable[[], None] = lambda: None
    """Called before every rendering; raises Cancelled to stop."""
    queries: int = 0
    renders: int = 0
    initial: Parameters = field(init=False)
    original: Tensor = field(init=False)

    def __post_init__(self) -> None:
        start = self.renderer.initial()
        self.initial = {group: start[group] for group in self.groups}
        with torch.no_grad():
            self.original = self.render({g: v[None] for g, v in self.initial.items()})

    def nothing(self) -> Parameters:
        """The perturbation of zeros."""
        return {group: torch.zeros_like(value) for group, value in self.initial.items()}

    def clamp(self, perturbation: Mapping[str, Tensor]) -> Parameters:
        """The perturbation, pulled back so that the perturbed parameters stay physically meaningful."""
        bounds = self.renderer.bounds()
        clamped = {}
        for group, value in perturbation.items():
            low, high = bounds[group]
            start = self.initial[group]
            clamped[group] = torch.minimum(torch.maximum(value, low - start), high - start)
        return clamped

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Pictures [B, H, W, 3]. Raises JobFailure("non-finite") rather than hand on a picture that is not numbers."""
        self.interrupt()
        images = self.renderer.render(parameters)
        self.renders += images.shape[0]
        if not bool(torch.isfinite(images.detach()).all()):
            raise JobFailure("non-finite", "the renderer returned a picture with values that are not finite")
        return images

    def view(self, perturbation: Mapping[str, Tensor], gradient: bool = False) -> View:
        """The picture of one perturbation, truncated to U around the original; with a graph if `gradient`."""
        leaves = {g: value.detach().requires_grad_(gradient) for g, value in perturbation.items()}
        with torch.set_grad_enabled(gradient):
            images = self.render({g: (self.initial[g] + value)[None] for g, value in leaves.items()})
            return View(leaves, *truncate(images, self.original, self.truncation))

    def logits(self, images: Tensor) -> Tensor:
        """Scores [B, K] of pictures. Raises JobFailure("non-finite")."""
        self.queries += images.shape[0]
        logits = self.target.logits(images, self.question)
        if not bool(torch.isfinite(logits.detach()).all()):
            raise JobFailure("non-finite", "the network returned scores that are not finite")
        return logits


def truncate(images: Tensor, original: Tensor, limit: float | None) -> tuple[Tensor, Tensor]:
    """Images with no RGB value further than `limit` from the original, and which pixels that held back.

    `images` [1, H, W, 3]; the mask is bool [H, W]. A held-back value passes no gradient (paper, section 3.3).
    """
    if limit is None:
        return images, torch.zeros(images.shape[1:3], dtype=torch.bool)
    held = ((images.detach() - original).abs() > limit + ROUNDING).any(dim=-1).any(dim=0)
    if not bool(held.any()):
        return images, held
    return torch.minimum(torch.maximum(images, original - limit), original + limit), held
