"""What a network is asked about a job's image, and how its answers are judged: its task.

The card of a target names its task, and a task is registered by a function that makes the `Task` of one job. Ours is
classification (`classification.Classification`); plug-ins add others. This module does not import torch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from scene_attack.runs.task_parts import TASKS, Ask, Cases, Part, RegisteredTask, ResultPart

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from scene_attack.analysis.subsets import ScoredImage
    from scene_attack.analysis.verdict import Verdict
    from scene_attack.attacks.goal import ResolvedGoal
    from scene_attack.attacks.limits import Constraint
    from scene_attack.rendering.protocol import Parameters
    from scene_attack.runs.result import FirstAnswer, JobWarning
    from scene_attack.runs.spec import AskedGoal, Goal, JobSpec
    from scene_attack.targets.protocol import Target


@dataclass(frozen=True)
class Settled:
    """A goal after the network has answered for the original image."""

    spec: Goal
    """The goal of the request with the truth and the labels to leave filled in."""
    goal: ResolvedGoal
    truth: tuple[int, ...]
    """The labels that are right; empty if nobody knows them."""
    warnings: tuple[JobWarning, ...]


class Task(Protocol):
    """The task of one job."""

    @property
    def target(self) -> Target:
        """The network under attack, with what it is asked."""
        ...

    def settle(self, original: Tensor, logits: Tensor) -> Settled:
        """Settles the goal, given the original image, uint8 [H, W, 3], and the target's scores [K] of it.

        Raises InvalidRequest for a goal that cannot be met or is met already.
        """
        ...

    def constraint(self, renderer: str, initial: Parameters) -> Constraint | None:
        """The limits of the search beside those of the request; `initial` are the attacked groups' values."""
        ...

    def plan(self) -> Part | None:
        """What the task adds to a plan, a `RegisteredTask.plan`; None for nothing."""
        ...

    def first_answers(self, original: Tensor, logits: Tensor, goal: ResolvedGoal) -> tuple[FirstAnswer, ...]:
        """The answers to the original image, one for each thing that is asked."""
        ...

    def judge(
        self, settled: Settled, renderer: str, stored: Parameters, before: ScoredImage, after: ScoredImage, out: Path
    ) -> tuple[Verdict, ResultPart | None]:
        """Returns the outcome of the attack and what the task adds to the result, whose files are written into `out`.

        `stored` is the perturbation, drawn by `renderer`; `before` and `after` are the exact images without and with
        it. The outcome follows from the truth, the answers before and after, and whether the goal is met.
        """
        ...


MakeTask = Callable[["JobSpec", "Target", "AskedGoal"], Task]
"""Makes the task of a job, given the loaded network and the goal in its labels. Raises InvalidRequest, which names the
field, for a request that asks what the network cannot answer."""


def register_task(
    name: str,
    *,
    ask: type[Ask] | None = None,
    cases: type[Cases] | None = None,
    plan: type[Part] | None = None,
    result: type[ResultPart] | None = None,
) -> Callable[[MakeTask], MakeTask]:
    """Returns a decorator of the function that makes the task of a job.

    The models are those of what the task adds to a request (`target.ask`), to a campaign's grid (`generate`), to a plan
    and to a result (`tasks[name]`); without one a request that has the field is refused. Raises ValueError for a name
    that is taken.
    """

    def decorate(make: MakeTask) -> MakeTask:
        TASKS.add(name, RegisteredTask(make, ask, cases, plan, result))
        return make

    return decorate
