"""The network's answer to a picture, in numbers a person reads."""

from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.attacks.goal import ResolvedGoal
from services.targets.scores import probability


class Answer(BaseModel):
    """The network's answer to one picture, as saved (8 bits)."""

    model_config = ConfigDict(extra="forbid")

    label: str
    index: int
    confidence: float = Field(description="probability of `label`")
    goal_probability: float = Field(description="probability of the goal's label (the one to leave, or to reach)")
    top: list[tuple[str, float]] = Field(description="the five most probable labels")


def answer(logits: Tensor, labels: tuple[str, ...], goal: ResolvedGoal) -> Answer:
    """The answer in scores [K]. On a tie the lower index wins, as in `ResolvedGoal.fooled`."""
    index = int(logits.argmax())
    order = logits.argsort(descending=True, stable=True)[:5].tolist()
    return Answer(
        label=labels[index],
        index=index,
        confidence=float(probability(logits, index)),
        goal_probability=float(probability(logits, goal.label)),
        top=[(labels[i], float(probability(logits, i))) for i in order],
    )
