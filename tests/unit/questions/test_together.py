"""Several questions as a network of two answers, against answers that are compared one at a time here."""

from types import SimpleNamespace
from typing import Any, cast

import torch
from torch import Tensor

from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.runs.spec import Goal
from scene_attack_questions.executor import ANSWERS, KINDS
from scene_attack_questions.target import ProgramTarget
from scene_attack_questions.task import Together, goals_together, outcome_of


class Scores:
    """A network whose scores of two questions are given."""

    name, input_size, differentiable, weights_sha256, backend = "scores", (1, 1), False, "0", "none"

    def __init__(self, scores: Tensor) -> None:
        self.scores = scores

    def answers(self, images: Tensor, questions: tuple[str, ...]) -> Tensor:
        return self.scores[None].expand(len(images), -1, -1)


def asked(right: str, kind: str) -> Any:
    return SimpleNamespace(right=right, kind=kind)


def test_a_goal_is_the_right_answer_or_its_whole_kind() -> None:
    both = [asked("3", "integer"), asked("cube", "shape")]
    assert [goal.leave for goal in goals_together(Goal(), both, leave_kind=False)] == [
        (ANSWERS.index("3"),),
        (ANSWERS.index("cube"),),
    ]
    kinds = goals_together(Goal(), both, leave_kind=True)
    assert [{ANSWERS[k] for k in goal.leave} for goal in kinds] == [set(KINDS["integer"]), set(KINDS["shape"])]


def test_the_goal_is_met_when_the_last_answer_has_left() -> None:
    random = torch.Generator().manual_seed(0)
    goals = (ResolvedGoal((0,), None), ResolvedGoal((3, 4), None))
    met = []
    for _ in range(50):
        scores = torch.randn(2, len(ANSWERS), generator=random)
        scores[0, 0] += 2
        scores[1, 3] += 2
        # the log-probability of what is to be left, less that of the best other answer
        advantages = [
            float(scores[n, list(goal.leave)].max() - scores[n, [k for k in range(28) if k not in goal.leave]].max())
            for n, goal in enumerate(goals)
        ]
        stays, left = Together(cast(ProgramTarget, Scores(scores)), ("", ""), goals).logits(torch.zeros(1, 1, 1, 3))[0]
        assert bool(left > stays) == all(one < 0 for one in advantages)
        assert torch.isclose((stays - left).sign(), torch.tensor(max(advantages)).sign())
        met.append([one < 0 for one in advantages])
    # there were all four cases
    assert {tuple(one) for one in met} == {(False, False), (False, True), (True, False), (True, True)}


def test_several_are_fooled_if_each_is() -> None:
    def several(*outcomes: str) -> Any:
        return outcome_of(cast(Any, [SimpleNamespace(outcome=one) for one in outcomes]))

    assert several("fooled", "fooled") == "fooled"
    assert several("fooled", "held") == several("held", "fooled") == several("held", "held") == "held"
    assert several("still-wrong") == "still-wrong"
