"""Transfer: whether an adversary also fools networks that it was not made for.

The exact image of the stored perturbation, rounded to 8 bits, is shown to other networks beside the original image.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from torch import Tensor

from scene_attack.analysis.records import Transferred
from scene_attack.analysis.rerendering import said
from scene_attack.analysis.verdict import judge
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.run import Verifier


@dataclass(frozen=True)
class Wanted:
    """Aim of an attack, in the label indices of the network that is asked."""

    truth: frozenset[int]
    """The labels that are right; empty if nobody knows them."""
    reach: int | None
    """The label to reach; None if there is none, or the network does not have it."""
    same: tuple[frozenset[int], ...]
    """Groups of labels that mean the same."""
    least_confidence: float

    def goal(self, first: int) -> ResolvedGoal:
        """The goal for a network that answers the original image by the label `first`: to leave the truth if it was
        right, and else its own answer with those that mean the same.
        """
        leave = self.truth
        if first not in leave:
            leave = frozenset([first]).union(*(group for group in self.same if first in group))
        return ResolvedGoal(tuple(sorted(leave)), self.reach, self.least_confidence)


def indices(names: Collection[str], labels: Sequence[str]) -> frozenset[int]:
    """The indices of those names that are among the labels."""
    return frozenset(index for index, label in enumerate(labels) if label in names)


def shown_to(verifier: Verifier, wanted: Wanted, original: Tensor, attacked: Tensor) -> Transferred:
    """The answers of the verifier's network to two images, uint8 [H, W, 3], and what they amount to.

    The outcome is judged as a job's is: only a network that was right about the original can be fooled.
    """
    before, after = verifier.logits(original), verifier.logits(attacked)
    labels = verifier.target.labels
    first, last = int(before.argmax()), int(after.argmax())
    met = bool(wanted.goal(first).fooled(after))
    return Transferred(
        target=verifier.target.name,
        before=said(before, labels),
        after=said(after, labels),
        outcome=judge(wanted.truth, first, last, met),
        right_before=first in wanted.truth if wanted.truth else None,
    )
