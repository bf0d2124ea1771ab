"""Several questions about one image, attacked together, as a network of two answers.

Its first label says that the answer to one of the questions still is as it was, its second that the goal of every
question is met. The difference of their scores is the largest advantage of a question (`ResolvedGoal.advantage`), that
of the question that is hardest at present. So every attack, the verifier and the trace work on it as on any network.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from services.attacks.attack import Goal
from services.attacks.goal import ResolvedGoal
from services.errors import InvalidRequest
from services.pipeline.goals import Settled
from services.pipeline.questions import AskedQuestion
from services.questions.answers import ANSWERS, KINDS
from services.rendering.color import from_bytes
from services.targets.protocol import ProgramTarget

LABELS = ("an answer stays", "all answers have left")


class Together:
    """A target of two labels for questions with a goal each; implements `Target`."""

    labels = LABELS
    takes_question = False

    def __init__(self, target: ProgramTarget, asked: Sequence[str], goals: Sequence[ResolvedGoal]) -> None:
        self.name, self.input_size = target.name, target.input_size
        self.differentiable, self.weights_sha256 = target.differentiable, target.weights_sha256
        self._target, self._asked, self._goals = target, tuple(asked), tuple(goals)

    @property
    def backend(self) -> str:
        """That of the network."""
        return self._target.backend

    def logits(self, images: Tensor) -> Tensor:
        """Returns scores [B, 2] of images [B, H, W, 3] in [0,1]; see `Target.logits`."""
        scores = self._target.answers(images, self._asked)
        advantages = [goal.advantage(scores[:, number]) for number, goal in enumerate(self._goals)]
        hardest = torch.stack(advantages).amax(dim=0)
        return torch.stack([hardest / 2, -hardest / 2], dim=1)


def goals_together(goal: Goal, questions: Sequence[AskedQuestion]) -> tuple[ResolvedGoal, ...]:
    """Returns the goal of each question: to leave its right answer, or the kind of answers.

    Raises InvalidRequest for a goal that names labels, which would be those of one question.
    """
    for name in ("truth", "leave", "reach"):
        if getattr(goal, name) is not None:
            raise InvalidRequest(f"goal.{name}", "several questions have answers of their own; leave it out")
    return tuple(
        ResolvedGoal(
            tuple(ANSWERS.index(one) for one in (KINDS[question.kind] if goal.leave_kind else (question.right,))),
            None,
            goal.least_confidence,
        )
        for question in questions
    )


@torch.no_grad()
def settled_together(
    target: ProgramTarget, goal: Goal, questions: Sequence[AskedQuestion], original: Tensor
) -> Settled:
    """Settles the goal, given the original image, uint8 [H, W, 3].

    Raises InvalidRequest ("target.questions.1") for a question that the network gets wrong, as there is nothing to
    attack.
    """
    scores = target.answers(from_bytes(original)[None], [question.asked for question in questions])[0]
    for question, best in zip(questions, scores.argmax(dim=1).tolist(), strict=True):
        if ANSWERS[best] != question.right:
            raise InvalidRequest(
                question.field,
                f"the network gets it wrong before the attack: it says {ANSWERS[best]!r}, not {question.right!r}; "
                "leave it out",
            )
    return Settled(goal, ResolvedGoal((0,), None), (0,), ())
