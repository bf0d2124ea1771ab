"""Restarts: random starts within ε after one that held, the best of them kept, the trace saying which is which."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from services.attacks.fgsm import Fgsm, FgsmMethod
from services.attacks.problem import AttackProblem, Evaluation
from services.attacks.run import AttackState, Budget, Verifier, run
from services.errors import Cancelled
from tests.unit.attacks.small import Ahead, FreeRenderer, LinearTarget, problem

STEPS = 3
EPSILON = {"a": 0.05, "b": 0.05}
RATES = Fgsm.model_construct(learning_rate={"a": 1e-4, "b": 1e-4}, momentum=0.0, weight_decay=0.0)


def case_of(target: LinearTarget | None = None) -> AttackProblem:
    """FGSM's steps are so short that it cannot leave the surroundings of its start."""
    return problem(FreeRenderer(), target or Ahead(FreeRenderer()), epsilon=EPSILON, seed=5)


def attack(case: AttackProblem, restarts: int, path: Path | None = None) -> AttackState:
    def fresh() -> FgsmMethod:
        return FgsmMethod(RATES, case)

    verifier = Verifier(case.renderer, case.target)
    return run(case, fresh(), verifier, Budget(STEPS), checkpoint_path=path, restarts=restarts, fresh=fresh)


def test_each_start_takes_its_steps_and_the_best_is_stored() -> None:
    case = case_of()
    found = attack(case, restarts=4)
    assert [row.restart for row in found.trace] == [n for n in range(5) for _ in range(STEPS + 1)]
    assert [row.step for row in found.trace] == list(range(5 * (STEPS + 1)))
    assert found.stopped == "steps"
    least = min(found.trace, key=lambda row: row.advantage)
    assert found.trace[found.stored_step].advantage == least.advantage
    starts = [found.trace[n * (STEPS + 1)] for n in range(5)]
    assert starts[0].distance == 0
    assert len({row.distance for row in starts}) == 5
    for group, limit in EPSILON.items():
        assert float(found.stored[group].abs().max()) <= limit


def test_a_method_sees_the_steps_of_its_own_start_and_another_seed() -> None:
    """Its schedule is over `steps`, and equal random numbers would waste the start."""
    case, seen = case_of(), []

    class Recording(FgsmMethod):
        def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
            seen.append((step, problem.seed))
            return super().advance(problem, view, step)

    def fresh() -> Recording:
        return Recording(RATES, case)

    run(case, fresh(), Verifier(case.renderer, case.target), Budget(STEPS), restarts=2, fresh=fresh)
    assert [step for step, _ in seen] == 3 * list(range(STEPS))
    assert [len({seed for _, seed in seen[n : n + STEPS]}) for n in (0, STEPS, 2 * STEPS)] == [1, 1, 1]
    assert len({seed for _, seed in seen}) == 3


def test_a_success_ends_the_restarts() -> None:
    """Some random points fool by themselves."""
    held = attack(case_of(LinearTarget()), restarts=30)
    assert held.trace[0].advantage > 0
    assert held.verified
    assert held.stopped == "verified"
    assert 0 < held.trace[-1].restart < 30
    assert held.stored_step == held.trace[-1].step


def test_a_resumed_attack_with_restarts_ends_in_the_same_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.attacks.run.EVERY", -1.0)  # after every step
    whole = attack(case_of(), restarts=3)
    for lives in (6, 9, 13):  # dies within a restart, and at the beginning of one
        case = case_of()
        left = iter(range(lives))

        def die(left: Iterator[int] = left) -> None:
            if next(left, None) is None:
                raise Cancelled

        case.interrupt = die
        path = tmp_path / f"checkpoint {lives}"
        with pytest.raises(Cancelled):
            attack(case, restarts=3, path=path)
        resumed = attack(case_of(), restarts=3, path=path)
        assert [row.model_copy(update={"seconds": 0}) for row in whole.trace] == [
            row.model_copy(update={"seconds": 0}) for row in resumed.trace
        ]
        for group, value in whole.stored.items():
            assert torch.equal(value, resumed.stored[group])
