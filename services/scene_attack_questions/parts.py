"""What questions add to a plan and to a result: `tasks.questions`. This module does not import torch."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from scene_attack.runs.task_parts import Part, ResultPart
from scene_attack_questions.records import ATTENTION, Asked, QuestionResult

if TYPE_CHECKING:
    from rich.console import RenderableType


class QuestionsPlan(Part):
    """The questions about the image, with their programs."""

    questions: tuple[Asked, ...]

    def tables(self, folder: Path | None = None) -> Iterable["RenderableType"]:
        """Each question with its program and its right answer."""
        del folder
        from scene_attack_questions.tables import asked_tables

        return asked_tables(self.questions)


class QuestionsResult(ResultPart):
    """The questions about the image, their programs and their answers."""

    template: ClassVar[Path | None] = Path(__file__).with_name("page.html")
    contents: ClassVar[Mapping[str, str]] = {
        "attention-*-before.png": "what a function of a question's program attends to in the original image",
        "attention-*-after.png": "the same in the attacked image",
        ATTENTION: "the masks of these functions, float32 in [0,1]",
    }

    questions: list[QuestionResult]

    @property
    def answers(self) -> list[tuple[str, str]]:
        """Those of several questions; one is answered as an image is."""
        if len(self.questions) == 1:
            return []
        return [(question.before.label, question.after.label) for question in self.questions]

    def tables(self, folder: Path | None = None) -> Iterable["RenderableType"]:
        """Each question with its answers before and after the attack."""
        from scene_attack_questions.tables import answered_tables

        return answered_tables(self.questions, folder)

    def shown(self, spec: Mapping[str, Any], result: Mapping[str, Any]) -> object:
        """The questions with their programs as trees, and the objects of the scene."""
        from scene_attack_questions.page import Page

        return Page.of(self.questions, spec, result)
