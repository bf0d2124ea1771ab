"""The plug-in: the task of networks that answer questions, and one such network. It does not import torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scene_attack.plugin import register_task
from scene_attack_questions.ask import Questions
from scene_attack_questions.grid import QuestionGrid
from scene_attack_questions.iep import card
from scene_attack_questions.parts import QuestionsPlan, QuestionsResult
from scene_attack_questions.source import Clevr

if TYPE_CHECKING:
    from scene_attack.runs.spec import AskedGoal, JobSpec
    from scene_attack.runs.task import Task
    from scene_attack.targets.protocol import Target

__all__ = ["INTERFACE", "Clevr", "card", "questions"]

INTERFACE = 1


@register_task("questions", ask=Questions, cases=QuestionGrid, plan=QuestionsPlan, result=QuestionsResult)
def questions(spec: JobSpec, network: Target, asked: AskedGoal) -> Task:
    """The task of a job; see `scene_attack_questions.task.task_of`."""
    from scene_attack_questions.task import task_of

    return task_of(spec, network, asked)
