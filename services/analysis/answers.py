"""The network's answer to an image as labels and probabilities."""

from torch import Tensor

from services.analysis.records import Answer
from services.attacks.goal import ResolvedGoal
from services.targets.scores import probability


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
