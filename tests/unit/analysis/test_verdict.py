"""Every combination of truth, first answer, attacked answer and goal; the intervals of rates of successes."""

from itertools import product

import pytest
from scipy.stats import binomtest

from scene_attack.analysis.verdict import SUCCESS, Verdict, judge, wilson

TRUTH, RIGHT, ALSO_RIGHT, WRONG, ALSO_WRONG = (0, 1), 0, 1, 2, 3

TABLE: list[tuple[tuple[int, ...], int, int, bool, Verdict]] = [
    # truth, first answer, attacked answer, goal met
    (TRUTH, RIGHT, WRONG, True, "fooled"),
    (TRUTH, RIGHT, WRONG, False, "held"),  # below the least confidence, or not the label to reach
    (TRUTH, RIGHT, RIGHT, True, "held"),
    (TRUTH, RIGHT, RIGHT, False, "held"),
    (TRUTH, RIGHT, ALSO_RIGHT, True, "held"),  # another right answer is none that is wrong
    (TRUTH, RIGHT, ALSO_RIGHT, False, "held"),
    (TRUTH, WRONG, RIGHT, True, "became-right"),
    (TRUTH, WRONG, RIGHT, False, "became-right"),
    (TRUTH, WRONG, WRONG, True, "still-wrong"),
    (TRUTH, WRONG, WRONG, False, "still-wrong"),
    (TRUTH, WRONG, ALSO_WRONG, True, "still-wrong"),
    (TRUTH, WRONG, ALSO_WRONG, False, "still-wrong"),
    ((), WRONG, ALSO_WRONG, True, "changed"),
    ((), WRONG, ALSO_WRONG, False, "held"),
    ((), WRONG, WRONG, True, "changed"),
    ((), WRONG, WRONG, False, "held"),
]


@pytest.mark.parametrize(("truth", "first", "attacked", "met", "outcome"), TABLE)
def test_the_outcome(truth: tuple[int, ...], first: int, attacked: int, met: bool, outcome: Verdict) -> None:
    assert judge(truth, first, attacked, met) == outcome


@pytest.mark.parametrize(
    ("first", "attacked", "met", "after", "outcome"),
    [
        (RIGHT, WRONG, True, (WRONG,), "held"),  # the new answer is right about the scene as it is now
        (RIGHT, WRONG, True, (ALSO_WRONG,), "fooled"),
        (RIGHT, RIGHT, False, (WRONG,), "held"),  # the scene has changed, the answer has not left
        (RIGHT, WRONG, True, (), "held"),  # nothing is right there
        (WRONG, ALSO_WRONG, True, (ALSO_WRONG,), "became-right"),
        (WRONG, RIGHT, True, (ALSO_WRONG,), "still-wrong"),
        (WRONG, WRONG, True, (), "still-wrong"),
    ],
)
def test_the_outcome_where_the_attack_changes_the_truth(
    first: int, attacked: int, met: bool, after: tuple[int, ...], outcome: Verdict
) -> None:
    assert judge(TRUTH, first, attacked, met, after) == outcome


def test_a_success_was_right_is_wrong_and_met_the_goal() -> None:
    """Over all combinations, those that are not in the table included."""
    for truth, first, attacked, met in product(((), (0,), TRUTH), range(4), range(4), (False, True)):
        success = judge(truth, first, attacked, met) == SUCCESS
        assert success == (first in truth and attacked not in truth and met)


CASES = [(8, 10), (0, 24), (24, 24), (5, 10), (0, 1), (208, 233)]


@pytest.mark.parametrize(("successes", "trials"), CASES)
def test_rates_have_wilsons_interval(successes: int, trials: int) -> None:
    """As scipy computes it, and by its definition: the roots of (p̂ − p)² = z² p (1 − p) / n, the score test."""
    found = wilson(successes, trials)
    assert found == pytest.approx(binomtest(successes, trials).proportion_ci(0.95, "wilson"), abs=1e-6)
    z2, rate = 1.959964**2, successes / trials
    for p in found:
        assert (rate - p) ** 2 == pytest.approx(z2 * p * (1 - p) / trials, abs=1e-12)


def test_an_interval_ends_at_a_rate_of_0_or_1() -> None:
    assert wilson(0, 7)[0] == 0.0
    assert wilson(7, 7)[1] == 1.0
