"""The goal of an attack as numbers: an objective to minimise and a test of success."""

from dataclasses import dataclass

from torch import Tensor

from services.errors import InvalidRequest
from services.targets.scores import advantage, log_odds, probability


@dataclass(frozen=True)
class ResolvedGoal:
    """A goal over label indices: if `reach` is None, the network must stop answering `leave`; else it must answer
    `reach`.

    All methods take logits [..., K]. `objective` and `advantage` raise InvalidRequest("target.name") if K is 1, since
    such a network has no other answer.
    """

    leave: int | None
    reach: int | None

    def __post_init__(self) -> None:
        if self.leave is None and self.reach is None:
            raise ValueError("a goal needs a label to leave or to reach")

    @property
    def label(self) -> int:
        """The label whose probability the trace records: `reach` if it is given, else `leave`."""
        label = self.leave if self.reach is None else self.reach
        assert label is not None
        return label

    def objective(self, logits: Tensor) -> Tensor:
        """The objective that FGSM minimises, [B]: the log-odds of the label to leave, or minus those of `reach`.

        Its gradient has the direction of the paper's loss (the probability) and does not vanish on a confident network.
        """
        _several(logits)
        odds = log_odds(logits, self.label)
        return odds if self.reach is None else -odds

    def advantage(self, logits: Tensor) -> Tensor:
        """Log-probability advantage of the present answer, [B]; negative once fooled (paper, attack curves)."""
        _several(logits)
        value = advantage(logits, self.label)
        return value if self.reach is None else -value

    def loss(self, logits: Tensor) -> Tensor:
        """The loss as the paper reports it, [B]: probability of the label to leave, or 1 minus that to reach."""
        value = probability(logits, self.label)
        return value if self.reach is None else 1 - value

    def fooled(self, logits: Tensor) -> Tensor:
        """Whether the most probable label meets the goal, [B] bool. On a tie the lower index is the answer."""
        answer = logits.argmax(dim=-1)
        return answer != self.label if self.reach is None else answer == self.label


def _several(logits: Tensor) -> None:
    if logits.shape[-1] < 2:
        raise InvalidRequest("target.name", "it has one label only; there is no other answer to bring it to")
