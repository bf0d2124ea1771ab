"""Confidence intervals of shares."""

from math import sqrt

NORMAL_95 = 1.959964
"""Two-sided 95 % quantile of the normal distribution."""


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % score interval of a rate (Wilson 1927). `trials` is at least 1. Rates of 0 and 1 are ends of it."""
    z2, rate = NORMAL_95**2, successes / trials
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = NORMAL_95 / (1 + z2 / trials) * sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2))
    return 0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half
