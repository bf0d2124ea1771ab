"""The verifier renders a perturbation afresh by the exact path, rounds it to 8 bits, and asks the network."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from services.attacks.contract import check_images, check_scores
from services.attacks.goal import ResolvedGoal
from services.errors import named
from services.rendering.color import from_bytes, to_bytes
from services.rendering.protocol import Renderer
from services.rendering.variation import Variation, noisy, varied
from services.targets.protocol import Target


@dataclass
class Verifier:
    """Answers for stored perturbations; never sees the loop's own images. Counts what it asks and renders.

    Raises JobFailure for what is no image, and for what are no scores (`contract`).
    """

    renderer: Renderer
    target: Target
    question: str | None = None
    queries: int = 0
    renders: int = 0

    @torch.no_grad()
    def render(self, perturbation: Mapping[str, Tensor], variation: Variation | None = None) -> Tensor:
        """The exact image [H, W, 3] in [0,1], not yet rounded. Groups left out are unperturbed; {} is the original.

        With a variation it is the image of the scene from that view and in that light.
        """
        exact = self.renderer.exact()
        start = exact.initial()
        changed = {g: (start[g] + perturbation[g].to(start[g].dtype))[None] for g in perturbation}
        self.renders += 1
        # always the whole parameter set: the same computation, bit for bit, for every subset of the groups
        parameters = {g: changed.get(g, start[g][None]) for g in exact.groups}
        with named(f"renderer {exact.name!r}"):
            images = exact.render(parameters if variation is None else varied(exact, parameters, variation))
        check_images(exact, images, 1)
        return images[0] if variation is None else noisy(images, variation)[0]

    def image(self, perturbation: Mapping[str, Tensor], variation: Variation | None = None) -> Tensor:
        """The exact image rounded to 8 bits, uint8 [H, W, 3], on the CPU."""
        return to_bytes(self.render(perturbation, variation)).cpu()

    @torch.no_grad()
    def logits(self, image: Tensor) -> Tensor:
        """Scores [K] of an image, uint8 [H, W, 3]. The batch is always of one image, so that no other changes bits."""
        self.queries += 1
        with named(f"target {self.target.name!r}"):
            logits = self.target.logits(from_bytes(image)[None], self.question)
        check_scores(self.target, logits, 1)
        return logits[0]

    def fooled(self, perturbation: Mapping[str, Tensor], goal: ResolvedGoal) -> bool:
        """Whether the network's answer to the exact image of the perturbation meets the goal."""
        return bool(goal.fooled(self.logits(self.image(perturbation))))
