"""Transfer: whether an adversary also fools networks that it was not made for.

The exact image of the stored perturbation, rounded to 8 bits, is shown to other networks beside the original image.
"""

from collections.abc import Sequence

from torch import Tensor

from services.analysis.records import Transferred
from services.analysis.rerendering import said
from services.attacks.goal import ResolvedGoal
from services.attacks.verifier import Verifier


def carried_goal(goal: ResolvedGoal, labels: Sequence[str], others: Sequence[str]) -> ResolvedGoal | None:
    """The same goal over another network's labels; None if they have no label of that name."""
    leave = None if goal.leave is None else labels[goal.leave]
    reach = None if goal.reach is None else labels[goal.reach]
    if any(name is not None and name not in others for name in (leave, reach)):
        return None
    return ResolvedGoal(None if leave is None else others.index(leave), None if reach is None else others.index(reach))


def shown_to(
    verifier: Verifier, goal: ResolvedGoal | None, original: Tensor, attacked: Tensor, renderer: str, note: str = ""
) -> Transferred:
    """The answers of the verifier's network to two images, uint8 [H, W, 3].

    `goal` is over that network's labels; without one only a change of the answer can be seen. It counts as fooled if
    the attacked image meets the goal and the original does not: a network that was wrong before is not fooled.
    """
    before, after = verifier.logits(original), verifier.logits(attacked)
    labels = verifier.target.labels
    fooled = None if goal is None else bool(goal.fooled(after)) and not bool(goal.fooled(before))
    was_right = None if goal is None else not bool(goal.fooled(before))
    return Transferred(
        target=verifier.target.name,
        renderer=renderer,
        before=said(before, labels),
        after=said(after, labels),
        changed=int(before.argmax()) != int(after.argmax()),
        was_right=was_right,
        fooled=fooled,
        note=note,
    )
