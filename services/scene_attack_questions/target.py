"""The protocol of networks that answer a question about a scene after CLEVR by its functional program."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from torch import Tensor

from scene_attack.targets.protocol import QuestionTarget
from scene_attack_questions.program import Program


@runtime_checkable
class ProgramTarget(QuestionTarget, Protocol):
    """A target that answers by the functional program of a question about a scene after CLEVR."""

    def program(self, question: str) -> Program:
        """Returns the program of a question, the same for every image.

        Raises InvalidRequest("question") for one that it cannot understand, InvalidProgram for an invalid program.
        """
        ...

    def answers(self, images: Tensor, questions: Sequence[str]) -> Tensor:
        """Returns the scores [B, Q, K] of each question to each of the images [B, H, W, 3]; `asked` serves a single
        question.
        """
        ...

    def attention(self, images: Tensor, question: str) -> list[Tensor | None]:
        """Returns the attention masks of the functions of the question's program in images [B, H, W, 3] in [0,1].

        Masks [B, h, w] in [0,1], float32 on the CPU; None for a function whose result has no place in the image.
        """
        ...
