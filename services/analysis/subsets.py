"""Subset ablation: applies every subset of a perturbation's groups, to tell which groups fool the network (paper,
section 4.1.2).
"""

from itertools import combinations

from torch import Tensor

from services.analysis.answers import answer
from services.analysis.perceptibility import of_images
from services.analysis.records import Subset
from services.attacks.goal import ResolvedGoal
from services.attacks.verifier import Verifier
from services.rendering.protocol import Parameters

ScoredImage = tuple[Tensor, Tensor]
"""An exact image rounded to 8 bits, uint8 [H, W, 3], and the network's scores of it, [K]."""


def subsets(
    verifier: Verifier, goal: ResolvedGoal, perturbation: Parameters, original: ScoredImage, attacked: ScoredImage
) -> list[Subset]:
    """Renders and classifies all 2^k subsets of k groups; the empty set is first and the full set is last.

    `original` and `attacked`, the images and scores of the empty and the full set, are used as they are, so that the
    table agrees with the result to the bit.
    """
    rows = []
    for size in range(len(perturbation) + 1):
        for groups in combinations(perturbation, size):
            if not groups:
                image, logits = original
            elif len(groups) == len(perturbation):
                image, logits = attacked
            else:
                image = verifier.image({g: perturbation[g] for g in groups})
                logits = verifier.logits(image)
            said = answer(logits, verifier.target.labels, goal)
            rows.append(
                Subset(
                    groups=list(groups),
                    label=said.label,
                    confidence=said.confidence,
                    goal_probability=said.goal_probability,
                    perceptibility=of_images(original[0], image),
                    fooled=bool(goal.fooled(logits)),
                )
            )
    return rows
