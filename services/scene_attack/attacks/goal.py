"""The goal of an attack as numbers: the losses to minimise, and a test of success.

Each loss is negative or falling where the goal is met. The log-odds take the place of cross-entropy: both are
increasing functions of the same probability, so a method that uses the gradient's direction takes the same steps, and
the log-odds do not saturate on a confident network.
"""

from dataclasses import dataclass
from math import log

import torch
from torch import Tensor

from scene_attack.attacks.request import LOSSES, Loss
from scene_attack.errors import InvalidRequest
from scene_attack.targets.scores import advantage, log_odds, log_odds_of_best_other, probability

SMALLEST_SPREAD = 1e-12
"""Added to the spread that the margin is divided by, as in the authors' code: equal scores are possible."""


@dataclass(frozen=True)
class ResolvedGoal:
    """A goal over label indices: if `reach` is None, the network must answer none of `leave`; else it must answer
    `reach`. The new answer must have at least the probability `least_confidence`, in [0,1).

    `leave` is a set of labels that count as one answer; it may be empty only if `reach` is given. All methods take
    logits [..., K] and return [...]. `objective` and `advantage` raise InvalidRequest("target.name") if the network has
    no label outside the set, since there is then no other answer.
    """

    leave: tuple[int, ...]
    reach: int | None
    least_confidence: float = 0.0

    def __post_init__(self) -> None:
        if not self.leave and self.reach is None:
            raise ValueError("a goal needs a label to leave or to reach")
        if not 0 <= self.least_confidence < 1:
            raise ValueError(f"the least confidence is {self.least_confidence}, not in [0, 1)")

    @property
    def labels(self) -> tuple[int, ...]:
        """The labels whose probability the trace records: `reach` if it is given, else `leave`."""
        return self.leave if self.reach is None else (self.reach,)

    def probability(self, logits: Tensor) -> Tensor:
        """The probability of `labels` together, float64."""
        return probability(logits, self.labels)

    def objective(self, logits: Tensor) -> Tensor:
        """The objective that gradient methods minimise: the log-odds of the labels to leave, or minus those of `reach`.

        Its gradient has the direction of the paper's loss (the probability) and does not vanish on a confident network.
        With a least confidence and no `reach` it is minus the log-odds of the most probable other label: to leave
        alone may spread the probability over many labels and give none of them the confidence.
        """
        _several(logits, self.labels)
        if self.reach is not None:
            return -log_odds(logits, self.labels)
        if self.least_confidence:
            return -log_odds_of_best_other(logits, self.leave)
        return log_odds(logits, self.leave)

    def advantage(self, logits: Tensor) -> Tensor:
        """Log-probability advantage of the present answer; negative once fooled (paper, attack curves).

        With a least confidence c it is the larger of that and log(c / (1 − c)) − the new answer's log-odds.
        """
        _several(logits, self.labels)
        value = advantage(logits, self.labels)
        if self.reach is not None:
            value = -value
        if not self.least_confidence:
            return value
        odds = log_odds_of_best_other(logits, self.leave) if self.reach is None else log_odds(logits, self.labels)
        return torch.maximum(value, log(self.least_confidence / (1 - self.least_confidence)) - odds)

    def loss(self, logits: Tensor) -> Tensor:
        """The loss as the paper reports it: probability of the labels to leave, or 1 minus that to reach."""
        value = self.probability(logits)
        return value if self.reach is None else 1 - value

    def fooled(self, logits: Tensor) -> Tensor:
        """Whether the most probable label meets the goal, bool. On a tie the lower index is the answer."""
        answer = logits.argmax(dim=-1, keepdim=True)
        named = (answer == torch.tensor(self.labels, device=logits.device)).any(dim=-1)
        met = ~named if self.reach is None else named
        if not self.least_confidence:
            return met
        confidence = torch.softmax(logits.double(), dim=-1).gather(-1, answer).squeeze(-1)
        return met & (confidence >= self.least_confidence)


def _several(logits: Tensor, labels: tuple[int, ...]) -> None:
    if logits.shape[-1] <= len(labels):
        raise InvalidRequest("target.name", "it has no label but those to leave or to reach; there is no other answer")


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
        others = ", ".join(loss for loss in LOSSES if loss != "dlr")
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
    if len(goal.leave) < 2:
        return logits
    whole = torch.tensor(goal.leave, device=logits.device)
    rest = logits.index_fill(-1, whole, -torch.inf)
    return torch.cat([logits.index_select(-1, whole).amax(dim=-1, keepdim=True), rest], dim=-1)
