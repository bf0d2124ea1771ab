"""Registers the library's own task. It does not import torch, so that the registry can list tasks without it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scene_attack.runs.task import Task, register_task

if TYPE_CHECKING:
    from scene_attack.runs.spec import AskedGoal, JobSpec
    from scene_attack.targets.protocol import Target


@register_task("classification")
def classification(spec: JobSpec, network: Target, asked: AskedGoal) -> Task:
    """The task of a job; see `scene_attack.runs.classification.seen`."""
    from scene_attack.runs.classification import seen

    return seen(spec, network, asked)
