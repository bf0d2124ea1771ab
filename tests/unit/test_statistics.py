import pytest
from scipy.stats import binomtest

from services.statistics import wilson

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
