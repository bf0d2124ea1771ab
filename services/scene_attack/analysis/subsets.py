"""Subset ablation: applies every subset of a perturbation's groups, to tell which groups fool the network (paper,
section 4.1.2).
"""

from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

from torch import Tensor

from scene_attack.analysis.images import answer, goal_log_odds, of_float_images, of_images
from scene_attack.analysis.records import Subset
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.protocol import Parameters


class ScoredImage(NamedTuple):
    """An exact image and the network's scores of it."""

    exact: Tensor
    """[H, W, 3] in [0,1], before it is rounded."""
    saved: Tensor
    """The same rounded to 8 bits, uint8 [H, W, 3]."""
    logits: Tensor
    """The scores of the saved image, [K]."""

    def judged(self, original: "ScoredImage", labels: tuple[str, ...], goal: ResolvedGoal) -> dict[str, Any]:
        """The fields of an analysis of this image: the answer, its visibility, and whether it meets the goal."""
        network_answer = answer(self.logits, labels, goal)
        return {
            "label": network_answer.label,
            "confidence": network_answer.confidence,
            "goal_probability": network_answer.goal_probability,
            "float_perceptibility": of_float_images(original.exact, self.exact),
            "perceptibility": of_images(original.saved, self.saved),
            "fooled": bool(goal.fooled(self.logits)),
        }


def scored(verifier: Verifier, perturbation: Parameters) -> ScoredImage:
    """Renders a perturbation by the exact path and asks the network."""
    exact = verifier.render(perturbation)
    saved = to_bytes(exact).cpu()
    return ScoredImage(exact, saved, verifier.logits(saved))


def subsets(
    verifier: Verifier,
    goal: ResolvedGoal,
    perturbation: Parameters,
    original: ScoredImage,
    attacked: ScoredImage,
    keep: Callable[[int, Tensor], None] = lambda _, __: None,
) -> list[Subset]:
    """Renders and classifies all 2^k subsets of k groups; the empty set is first and the full set is last.

    `original` and `attacked`, the images and scores of the empty and the full set, are used as they are, so that the
    table agrees with the result to the bit. `keep` is called with the row and the image, uint8 [H, W, 3], of each
    other subset.
    """
    rows: list[Subset] = []
    for size in range(len(perturbation) + 1):
        for groups in combinations(perturbation, size):
            if not groups:
                image = original
            elif len(groups) == len(perturbation):
                image = attacked
            else:
                image = scored(verifier, {g: perturbation[g] for g in groups})
                keep(len(rows), image.saved)
            shown = image.judged(original, verifier.target.labels, goal)
            rows.append(Subset(groups=list(groups), goal_log_odds=goal_log_odds(image.logits, goal), **shown))
    return rows
