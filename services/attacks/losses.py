"""The losses that gradient methods and Square may minimise, over the label sets of a goal.

Each is negative or falling where the goal is met. The log-odds take the place of cross-entropy: both are increasing
functions of the same probability, so a method that uses the gradient's direction takes the same steps, and the log-odds
do not saturate on a confident network.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.attacks.attack import LOSSES, Loss
from services.errors import InvalidRequest

if TYPE_CHECKING:
    from torch import Tensor

    from services.attacks.goal import ResolvedGoal

SMALLEST_SPREAD = 1e-12
"""Added to the spread that the margin is divided by, as in the authors' code: equal scores are possible."""


def loss(name: Loss, goal: ResolvedGoal, logits: Tensor) -> Tensor:
    """The loss `name` of logits [..., K], to be minimised: [...]. Raises InvalidRequest as `check_loss` does."""
    if name == "log-odds":
        return goal.objective(logits)
    if name == "margin":
        return goal.advantage(logits)
    return _dlr(goal, logits)


def check_loss(name: Loss, goal: ResolvedGoal, classes: int) -> None:
    """Raises InvalidRequest("attack.loss") if the loss needs more classes than the network has.

    The labels to leave count as one class.
    """
    least = _largest_scores(goal)
    there = classes - max(0, len(goal.leave) - 1)
    if name == "dlr" and there < least:
        kind = "targeted" if goal.reach is not None else "non-targeted"
        others = ", ".join(one for one in LOSSES if one != "dlr")
        raise InvalidRequest(
            "attack.loss", f"dlr needs at least {least} classes in a {kind} attack, here are {there}; use {others}"
        )


def _dlr(goal: ResolvedGoal, logits: Tensor) -> Tensor:
    """Difference-of-logits ratio (Croce & Hein 2020, equations 5 and 6). Scaling or shifting the scores leaves it.

    A targeted goal is measured against the largest other score, not against the true label's alone, since any other
    label above the target is a failure.
    """
    check_loss("dlr", goal, logits.shape[-1])
    top = _merged(goal, logits).topk(_largest_scores(goal), dim=-1).values
    lower = top[..., 2] if goal.reach is None else (top[..., 2] + top[..., 3]) / 2
    return goal.advantage(logits) / (top[..., 0] - lower + SMALLEST_SPREAD)


def _largest_scores(goal: ResolvedGoal) -> int:
    return 3 if goal.reach is None else 4


def _merged(goal: ResolvedGoal, logits: Tensor) -> Tensor:
    """The scores with the labels to leave as one class of their largest score."""
    import torch

    if len(goal.leave) < 2:
        return logits
    whole = torch.tensor(goal.leave, device=logits.device)
    rest = logits.index_fill(-1, whole, -torch.inf)
    return torch.cat([logits.index_select(-1, whole).amax(dim=-1, keepdim=True), rest], dim=-1)
