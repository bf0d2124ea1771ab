"""ZOO through the real pyrender renderer: coordinates that change nothing are left out, and only those."""

from pathlib import Path

import pytest
import torch

from scene_attack.attacks.differences import estimate
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem
from scene_attack.attacks.run import AttackRun, Verifier
from scene_attack.attacks.zoo import ZOO
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Lights, PointLight
from tests.unit.attacks.small import LinearTarget, attack, stepped
from tests.unit.rendering.shapes import mesh, placed, quad, scene

BEHIND = PointLight(energy=15.0, position=(0.3, 0.2, -1.0))
BEFORE = PointLight(energy=15.0, position=(0.3, 0.2, 1.5))
SKIPPED = {"point 1 energy", "point 1 x", "point 1 y", "point 1 z"}


def problem(*lights: PointLight) -> AttackProblem:
    description = scene((4, 5), lights=Lights(ambient=0.3, points=lights))
    renderer = PyrenderRenderer(placed(description, mesh(quad(0.5, color=(0.4, 0.5, 0.6, 1)))))
    groups = renderer.plan.groups
    return AttackProblem.of(renderer, LinearTarget(), ResolvedGoal((0,), None), Limits.of(renderer, groups))  # type: ignore[arg-type]


def settings(**changes: object) -> ZOO:
    values = {"coordinates": 128, "delta": 1e-2, "learning_rate": 2e-3, "steps": 10}
    return ZOO.model_construct(**(values | changes))  # type: ignore[arg-type]


def test_skipped_coordinates_are_listed_and_not_asked_about() -> None:
    case = problem(BEFORE, BEHIND)
    state = settings().init(case)
    found = settings().measured(case, state)
    assert {one["coordinate"] for one in found["skipped"]} == SKIPPED  # type: ignore[attr-defined]
    asked = case.counts.queries
    state = stepped(case, settings(), state, 0)
    assert case.counts.queries - asked == 1 + 2 * (18 - 4)  # the loop's own look is the first
    assert (state["delta"][5:9] == 0).all()


def test_the_budget_goes_to_the_others() -> None:
    case = problem(BEFORE, BEHIND)
    zoo = settings(coordinates=14)
    state = zoo.init(case)
    asked = case.counts.queries
    state = stepped(case, zoo, state, 0)
    assert case.counts.queries - asked == 1 + 28
    assert (state["moves"] > 0).sum() + (state["delta"] == 0).sum() >= 14


def test_skipping_loses_nothing_and_keeping_is_needed() -> None:
    """Every skipped coordinate has a gradient of zero; leaving a kept one out would lose its gradient."""
    case = problem(BEFORE, BEHIND)
    state = settings().init(case)
    total = case.layout.total
    gradients = estimate(case, torch.zeros(total), torch.arange(total), state["half_steps"], 0.0).gradients
    assert (gradients[state["inactive"]] == 0).all()
    kept = gradients[~state["inactive"]]
    # of a square that is centred in view and faces the camera: turning it about z or x and y is seen, like all else
    assert (kept != 0).sum() >= 12


def test_a_coordinate_that_comes_to_matter_is_taken_up() -> None:
    case = problem(BEFORE, BEHIND)
    state = settings().init(case)
    state["delta"][case.layout.starts["translation"] + 2] = -2.0  # the square moves behind the light
    asked = case.counts.queries
    stepped(case, settings(), state, 0)
    assert case.counts.queries - asked == 1 + 36


def test_what_is_skipped_survives_a_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scene_attack.attacks.run.CHECKPOINT_SECONDS", -1.0)  # after every step
    zoo, path = settings(coordinates=5), tmp_path / "checkpoint"
    whole, _ = attack(problem(BEFORE, BEHIND), zoo, steps=2), attack(problem(BEFORE, BEHIND), zoo, path, steps=1)
    case = problem(BEFORE, BEHIND)
    resumed = AttackRun.begin_or_resume(case, zoo, Verifier.of(case), path)
    assert resumed.state["inactive"].any()
    state = stepped(case, zoo, resumed.state, 1)
    assert torch.equal(whole.state["delta"], state["delta"])
