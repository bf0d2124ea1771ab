"""Records of an attack: a row of its trace for each step, from which the dashboard draws its curves, and the
verdict, from the truth and the network's answers. This module does not import torch, so that the API can read it.
"""

from collections.abc import Collection, Mapping
from math import sqrt
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field


class TraceRow(BaseModel):
    """The state at the start of a step, before its update; scores are those of the image rounded to 8 bits."""

    model_config = ConfigDict(extra="forbid")

    step: int
    restart: int = Field(0, description="number of the start that this step belongs to; the first is 0")
    loss: float = Field(description="probability of the labels to leave, or 1 minus that of the label to reach")
    label: str = Field(description="the network's answer: its most probable label")
    confidence: float = Field(description="probability of `label`")
    advantage: float = Field(
        description="largest log p of the labels to leave − largest other log p; targeted: largest other log p − log "
        "p_reach; with a least confidence c the larger of that and log(c / (1 − c)) − the new answer's log-odds; below "
        "0: the goal is met"
    )
    objective: float = Field(
        description="what the method minimises: the advantage, or for a method with gradients the log-odds of the "
        "label to leave or minus those of the label to reach, plus λ·distance²"
    )
    share: float | None = Field(
        None,
        description="with an expectation: share of the step's variations whose answer meets the goal; `objective` is "
        "then the mean over them and the scene itself, all else is of the scene itself; null without one",
    )
    distance: float = Field(description="‖ΔY‖₂ of the float image over all pixels and channels, RGB in [0,1]")
    perceptibility: float = Field(description="p(ΔY) of the float image")
    truncated: int = Field(description="pixels with a value truncated to U in this step")
    below_noise: int = Field(
        0,
        description="in the update before this row: differences below the noise (zoo), groups whose gradient is zero "
        "(fgsm)",
    )
    queries: int = Field(description="network queries so far, verification included")
    surrogate_queries: int = Field(0, description="images that the surrogate classified so far (p-rgf)")
    renders: int = Field(description="images rendered so far")
    seconds: float = Field(description="run time of the attack so far, over all attempts of the job")


class AttackCost(BaseModel):
    """The cost of an attack, over all attempts of its job; what only its report needs is not counted."""

    model_config = ConfigDict(extra="forbid")

    steps: int
    queries: int = Field(description="images that the target classified, verification included")
    surrogate_queries: int = Field(0, description="images that the surrogate classified, if the attack has one")
    renders: int
    truncated: int = Field(description="pixels that were truncated in at least one step")
    seconds: float


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


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % score interval of a rate (Wilson 1927). `trials` is at least 1. Rates of 0 and 1 are ends of it."""
    z2, rate = NORMAL_95**2, successes / trials
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = NORMAL_95 / (1 + z2 / trials) * sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2))
    return 0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half
