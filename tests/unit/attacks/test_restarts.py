"""Restarts: random starts within ε after one that held, the best of them kept, the trace saying which is which."""

from pathlib import Path

import pytest

from scene_attack.attacks.attack import State
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.problem import AttackProblem, Evaluation
from scene_attack.attacks.run import AttackRun
from tests.unit.attacks.small import Ahead, FreeRenderer, LinearTarget, attack, problem, resumed

STEPS = 3
EPSILON = {"a": 0.05, "b": 0.05}
RATES = FGSM.model_construct(learning_rate={"a": 1e-4, "b": 1e-4}, momentum=0.0, weight_decay=0.0)


def case_of(target: LinearTarget | None = None) -> AttackProblem:
    """FGSM's steps are so short that it cannot leave the surroundings of its start."""
    return problem(FreeRenderer(), target or Ahead(FreeRenderer()), epsilon=EPSILON, seed=5)


def restarted(case: AttackProblem, restarts: int, path: Path | None = None) -> AttackRun:
    return attack(case, RATES, path, steps=STEPS, restarts=restarts)


def test_each_start_takes_its_steps_and_the_best_is_stored() -> None:
    case = case_of()
    found = restarted(case, restarts=4)
    assert [row.restart for row in found.trace] == [n for n in range(5) for _ in range(STEPS + 1)]
    assert [row.step for row in found.trace] == list(range(5 * (STEPS + 1)))
    assert found.stopped == "steps"
    least = min(found.trace, key=lambda row: row.advantage)
    assert found.best is not None
    assert found.trace[found.best.step].advantage == least.advantage
    starts = [found.trace[n * (STEPS + 1)] for n in range(5)]
    assert starts[0].distance == 0
    assert len({row.distance for row in starts}) == 5
    for group, limit in EPSILON.items():
        assert float(found.stored[group].abs().max()) <= limit


def test_a_method_sees_the_steps_of_its_own_start_and_another_seed() -> None:
    """Its schedule is over `steps`, and equal random numbers would waste the start."""
    case, seen = case_of(), []

    class Recording(FGSM):
        def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
            seen.append((evaluation.step, problem.seed))
            return super().step(problem, state, evaluation)

    attack(case, Recording.model_construct(**dict(RATES)), steps=STEPS, restarts=2)
    assert [step for step, _ in seen] == 3 * list(range(STEPS))
    assert [len({seed for _, seed in seen[n : n + STEPS]}) for n in (0, STEPS, 2 * STEPS)] == [1, 1, 1]
    assert len({seed for _, seed in seen}) == 3


def test_a_success_ends_the_restarts() -> None:
    """Some random points fool by themselves."""
    held = restarted(case_of(LinearTarget()), restarts=30)
    assert held.trace[0].advantage > 0
    assert held.verified
    assert held.stopped == "verified"
    assert 0 < held.trace[-1].restart < 30
    assert held.best is not None
    assert held.best.step == held.trace[-1].step


@pytest.mark.parametrize("renders", [6, 9, 13])
def test_a_resumed_attack_with_restarts_ends_in_the_same_result(renders: int, tmp_path: Path) -> None:
    """It is cancelled within a restart, and at the beginning of one."""
    resumed(case_of, RATES, tmp_path / "checkpoint", renders, steps=STEPS, restarts=3)
