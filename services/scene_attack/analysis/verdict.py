"""The verdict on an attack, from the truth and the network's answers, and the interval of a rate of verdicts. This
module does not import torch, so that the API can read it.
"""

from collections.abc import Collection, Mapping
from math import sqrt
from typing import Any, Literal, TypeVar

Verdict = Literal["fooled", "changed", "became-right", "still-wrong", "held"]

Label = TypeVar("Label", int, str)
SUCCESS: Verdict = "fooled"
"""The only outcome that counts as a success of an attack."""
WRONG_BEFORE: tuple[Verdict, ...] = ("became-right", "still-wrong")
"""The outcomes of scenes that the network had wrong; beside them "verified" would read as a success."""


def judge(
    truth: Collection[Label],
    first: Label,
    attacked: Label,
    met: bool,
    truth_after: Collection[Label] | None = None,
) -> Verdict:
    """Returns the outcome, given the true labels (empty: nobody knows them), the answers to the original image and to
    the exact image of the stored perturbation, and whether the latter meets the goal.

    | truth   | first answer | attacked answer | goal met | not met     |
    |---------|--------------|-----------------|----------|-------------|
    | known   | right        | wrong           | fooled   | held        |
    | known   | right        | right           | held     | held        |
    | known   | wrong        | right           | became-right, either way |
    | known   | wrong        | wrong           | still-wrong, either way  |
    | unknown | any          | any             | changed  | held        |

    `truth_after` are the labels that are right for the attacked image, if the attack may have changed what is right
    (a red cube made blue is no adversary): `attacked` is right or wrong by them. None: the same labels. If they are
    empty, nothing is right there, and nothing is fooled.

    The same for targeted goals: there a wrong answer other than the label to reach does not meet the goal. A right
    answer that is not the first one meets no goal that leaves the whole truth; a targeted one is refused before.
    """
    if not truth:
        return "changed" if met else "held"
    after = truth if truth_after is None else truth_after
    if first not in truth:
        return "became-right" if attacked in after else "still-wrong"
    return "fooled" if met and after and attacked not in after else "held"


def held_within(outcome: Mapping[str, Any]) -> str:
    """Returns the limits that bound an attack that held, by the fields of a job's outcome.

    For example "within ε, p used 21.30 of 50.00 ×10⁻³". The text is empty unless ε was reached.
    """
    if outcome["outcome"] != "held" or not outcome.get("epsilon_bound"):
        return ""
    limit = outcome.get("perceptibility_limit")
    if limit is None:
        return "within ε"
    return f"within ε, p used {1000 * outcome['float_perceptibility']:.2f} of {1000 * limit:.2f} ×10⁻³"


NORMAL_95 = 1.959964
"""Two-sided 95 % quantile of the normal distribution."""


def wilson(successes: float, trials: int) -> tuple[float, float]:
    """The 95 % score interval of a rate (Wilson 1927). `trials` is at least 1. Rates of 0 and 1 are ends of it."""
    z2, rate = NORMAL_95**2, successes / trials
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = NORMAL_95 / (1 + z2 / trials) * sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2))
    return 0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half
