"""Every registered attack lowers its own objective through the loop, and ends in the same bits when it is resumed."""

from pathlib import Path
from typing import Any

import pytest
import torch

from scene_attack.attacks.attack import ATTACKS, Attack
from scene_attack.attacks.problem import AttackProblem
from tests.unit.attacks.small import Ahead, Pixels, attack, guided, problem, resumed, stepped

pytestmark = pytest.mark.slow

LIMIT = {"image": 6 / 255}
BUILT_IN = sorted(
    name for name, one in ATTACKS.items() if one.__module__.startswith("scene_attack.") and name != "natural-gradient"
)
"""But for the one that works on no pixels; test_natural_gradient.py has it."""
STEPS = 25


def settings(name: str) -> Attack:
    rate = {"learning_rate": {"image": 2e-3}} if name in ("fgsm", "mi-fgsm", "zoo") else {}
    given: dict[str, Any] = {"method": name, "renderer": "image", "epsilon": LIMIT, "steps": STEPS} | rate
    return ATTACKS[name].model_validate(given)


def build(name: str) -> AttackProblem:
    renderer = Pixels(dtype=torch.float32)
    return problem(renderer, Ahead(renderer), loss=settings(name).objective, epsilon=LIMIT)


def test_all_are_here() -> None:
    assert {"apgd", "cma-es", "fgsm", "mi-fgsm", "p-rgf", "spsa", "square", "zoo"} <= set(BUILT_IN)


@pytest.mark.parametrize("name", BUILT_IN)
def test_it_lowers_its_objective(name: str) -> None:
    """By at least a third of all that the limit allows, which for a linear network is known."""
    case = build(name)
    found = attack(case, settings(name))
    assert found.best is not None
    assert found.stopped == "steps"
    rows = case.target.weights  # type: ignore[attr-defined]
    towards = [
        0.02 * (rows[:, case.goal.leave[0]] - rows[:, k]).abs().sum() for k in range(4) if k != case.goal.leave[0]
    ]
    most = LIMIT["image"] * float(max(towards))
    fall = found.trace[0].advantage - found.trace[found.best.step].advantage
    assert fall > most / 3
    assert found.trace[found.best.step].advantage == min(row.advantage for row in found.trace)
    assert float(found.stored["image"].abs().max()) <= LIMIT["image"] + 1e-6


@pytest.mark.parametrize("name", ["fgsm", "mi-fgsm", "spsa", "zoo"])
def test_it_goes_on_from_the_perturbation_that_was_evaluated(name: str) -> None:
    """Which backtracking may have pulled back from the one that the method asked for."""
    case = build(name)
    state = stepped(case, settings(name), settings(name).init(case), 0)
    asked = state["delta"]
    evaluated = -0.7 * LIMIT["image"] * asked.sign()
    found = settings(name).step(case, state, guided(case, evaluated, 1))["delta"]
    step = 2e-3 if name != "spsa" else LIMIT["image"] / 16
    moved = case.initial + evaluated
    within = (moved > LIMIT["image"]) & (moved < 1 - LIMIT["image"])  # elsewhere the bounds of a pixel move it too
    assert float((found - evaluated)[within].abs().max()) < 2.1 * step
    assert float((found - asked)[within].abs().max()) > 4 * step


@pytest.mark.parametrize("name", BUILT_IN)
def test_resumed_it_ends_in_the_same_bits(name: str, tmp_path: Path) -> None:
    resumed(lambda: build(name), settings(name), tmp_path / "checkpoint")
