from dataclasses import replace

import pytest
import torch

from scene_attack.attacks.apgd import APGD
from scene_attack.attacks.attack import State
from scene_attack.attacks.problem import AttackProblem, evaluate
from scene_attack.attacks.run import AttackRun, Verifier, check_masking
from scene_attack.attacks.square import Square, square_side
from tests.unit.attacks.small import Ahead, LinearTarget, Pixels, attack, problem, stepped

EPSILON = 4 / 255
STEPS = 60


def held(seed: int) -> tuple[AttackRun, AttackProblem]:
    """An attack that takes all its steps."""
    renderer = Pixels()
    target = Ahead(renderer)
    case = problem(renderer, target, loss="margin", epsilon={"image": EPSILON}, seed=seed)
    settings = Square.model_construct(epsilon={"image": EPSILON}, steps=STEPS, share=0.8)
    return attack(case, settings), case


def test_a_step_is_one_query() -> None:
    found, case = held(0)
    assert found.stopped == "steps"
    assert [row.queries for row in found.trace] == list(range(1, STEPS + 2))
    assert case.counts.queries == STEPS + 1


def test_it_keeps_what_lowers_the_objective_and_every_pixel_is_at_a_limit() -> None:
    found, case = held(1)
    least = min(row.advantage for row in found.trace[1:])
    assert found.best is not None
    assert found.trace[found.best.step].advantage == least < found.trace[1].advantage
    moved = found.stored["image"]
    at_limit = (moved.abs() - EPSILON).abs() < 1e-9
    at_edge = (case.original[0] + moved <= 1e-9) | (case.original[0] + moved >= 1 - 1e-9)
    assert bool((at_limit | at_edge).all())


def test_the_first_image_has_vertical_stripes() -> None:
    renderer, target = Pixels(), LinearTarget()
    case = problem(renderer, target, epsilon={"image": EPSILON})
    square = Square.model_construct(epsilon={"image": EPSILON}, steps=10, share=0.8)
    stripes = stepped(case, square, square.init(case), 0)["delta"].reshape(4, 5, 3)
    assert bool((stripes == stripes[:1]).all())
    assert len(stripes.sign().unique()) == 2


def test_a_proposal_is_the_best_but_for_one_square_of_one_sign_a_channel() -> None:
    again = problem(Pixels(), LinearTarget(), loss="margin", epsilon={"image": EPSILON})
    square = Square.model_construct(epsilon={"image": EPSILON}, steps=10_000, share=0.1)
    state = square.init(again)
    for step in range(40):
        state = stepped(again, square, state, step)
        if step == 0:
            continue
        changed = (state["delta"] != state["best"]).reshape(4, 5, 3).any(-1).nonzero()
        if len(changed):  # a square may find its pixels at that sign already
            low, high = changed.amin(0), changed.amax(0)
            assert int((high - low).max()) < square_side(0.1, step - 1, 10_000, (4, 5))


def test_the_signs_of_a_square_are_drawn_for_each_channel_and_only_what_is_better_is_kept() -> None:
    """As in the authors' code: of a square that changes nothing of the objective, the one before stays."""
    case = problem(Pixels(), LinearTarget(), loss="margin", epsilon={"image": EPSILON})
    square = Square.model_construct(epsilon={"image": EPSILON}, steps=10_000, share=0.1)

    def stepped_at(objective: float, state: State, step: int) -> State:
        return square.step(case, state, replace(evaluate(case, state["delta"], step), objective=objective))

    state = stepped_at(1.0, stepped_at(1.0, square.init(case), 0), 1)
    first, mixed = state["best"], 0
    for step in range(2, 30):
        signs = (state["delta"] - first).sign()
        mixed += bool((signs > 0).any() & (signs < 0).any())
        state = stepped_at(1.0, state, step)
        assert torch.equal(state["best"], first)
    assert mixed > 5
    better = state["delta"]
    assert torch.equal(stepped_at(0.9, state, 30)["best"], better)


def test_the_stripes_are_no_step_of_the_schedule() -> None:
    """The authors count iterations from 0 after the stripes. Of 1,000 steps the first halving is before iteration 2,
    whose square is of √(0.8/2·20) ≈ 3 rows; those before are of √(0.8·20) = 4.
    """
    case = problem(Pixels(), LinearTarget(), loss="margin", epsilon={"image": EPSILON})
    square = Square.model_construct(epsilon={"image": EPSILON}, steps=1000, share=0.8)
    state, rows = square.init(case), []
    for step in range(4):
        state = stepped(case, square, state, step)
        moved = case.layout.unflatten(state["delta"] != state["best"])["image"]
        rows.append(int(moved.flatten(1).any(dim=1).sum()))
    assert rows[1:] == [4, 4, 3]


@pytest.mark.parametrize(
    ("step", "side"),
    [(0, 200), (10, 200), (11, 142), (51, 100), (201, 71), (501, 50), (1001, 35), (9999, 9)],
)
def test_squares_shrink_as_in_the_authors_code(step: int, side: int) -> None:
    """Sides √(0.8/2ᵏ·224²) of a run of 10,000 steps, and of a shorter one at the same share of its steps."""
    assert square_side(0.8, step, 10_000, (224, 224)) == side
    assert square_side(0.8, 0, 10, (4, 5)) == 4
    assert square_side(1e-9, 0, 10, (4, 5)) == 1


def test_the_same_seed_gives_the_same_attack() -> None:
    assert torch.equal(held(3)[0].stored["image"], held(3)[0].stored["image"])
    assert not torch.equal(held(3)[0].stored["image"], held(4)[0].stored["image"])


def test_it_fools_a_network_whose_gradient_is_zero() -> None:
    """Its use as an alarm: scores rounded to steps, through which no gradient passes."""

    class Stairs(LinearTarget):
        def logits(self, images: torch.Tensor) -> torch.Tensor:
            return (20 * super().logits(images)).round() / 20

    renderer, target, limits = Pixels(), Stairs(scale=3.0), {"image": EPSILON}
    found = {}
    for kind in (APGD, Square):
        case = problem(renderer, target, loss="margin", epsilon=limits)
        found[kind.__name__.lower()] = attack(case, kind.model_construct(epsilon=limits, steps=STEPS))
    assert not found["apgd"].fooled
    assert found["apgd"].trace[-1].below_noise == 1
    assert found["square"].verified


def test_the_masking_check_is_square_within_the_same_limits_and_counts_what_it_asks() -> None:
    for scale, outcome in ((3.0, "fooled"), (1e-6, "held")):
        renderer = Pixels()
        target = LinearTarget(scale=scale) if outcome == "fooled" else Ahead(renderer)
        case = problem(renderer, target, epsilon={"image": EPSILON})
        apgd = APGD.model_construct(epsilon={"image": EPSILON}, steps=1)
        found = check_masking(AttackRun.begin_or_resume(case, apgd, Verifier.of(case)), 30)
        assert found["square"] == outcome
        assert case.counts.queries == found["queries"] + 1 + (outcome == "fooled")  # type: ignore[operator]
        assert found["queries"] == 30 or outcome == "fooled"
