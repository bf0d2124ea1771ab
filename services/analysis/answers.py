"""The network's answer to an image as labels and probabilities."""

from torch import Tensor

from services.analysis.records import Answer
from services.attacks.goal import ResolvedGoal
from services.targets.scores import log_odds, probability


def answer(logits: Tensor, labels: tuple[str, ...], goal: ResolvedGoal) -> Answer:
    """The answer that scores [K] give. On a tie the lower index is the answer, as in `ResolvedGoal.fooled`."""
    index = int(logits.argmax())
    order = logits.argsort(descending=True, stable=True)[:5].tolist()
    return Answer(
        label=labels[index],
        index=index,
        confidence=float(probability(logits, index)),
        goal_probability=float(goal.probability(logits)),
        top=[(labels[i], float(probability(logits, i))) for i in order],
    )


def goal_log_odds(logits: Tensor, goal: ResolvedGoal) -> float:
    """The log-odds of the goal's labels (those to leave, or the one to reach) given scores [K], in float64."""
    return float(log_odds(logits.double(), goal.labels))
