"""Which groups did the damage: the found perturbation with every subset of its groups (paper, section 4.1.2)."""

from itertools import combinations

from torch import Tensor

from services.analysis.answers import answer
from services.analysis.perceptibility import of_pictures
from services.analysis.records import Subset
from services.attacks.exact import Judge
from services.attacks.goal import ResolvedGoal
from services.rendering.protocol import Parameters


def subsets(
    judge: Judge, goal: ResolvedGoal, perturbation: Parameters, original: Tensor, attacked: Tensor
) -> list[Subset]:
    """All 2^k subsets, the empty one first and the full one last. Pictures uint8 [H, W, 3].

    The empty and the full set are the pictures already judged, so that the table agrees with the result to the bit.
    """
    rows = []
    for size in range(len(perturbation) + 1):
        for groups in combinations(perturbation, size):
            picture = _picture(judge, {g: perturbation[g] for g in groups}, len(perturbation), original, attacked)
            logits = judge.logits(picture)
            said = answer(logits, judge.target.labels, goal)
            rows.append(
                Subset(
                    groups=list(groups),
                    label=said.label,
                    confidence=said.confidence,
                    goal_probability=said.goal_probability,
                    perceptibility=of_pictures(original, picture),
                    fooled=bool(goal.fooled(logits)),
                )
            )
    return rows


def _picture(judge: Judge, part: Parameters, groups: int, original: Tensor, attacked: Tensor) -> Tensor:
    if not part:
        return original
    return attacked if len(part) == groups else judge.picture(part)
