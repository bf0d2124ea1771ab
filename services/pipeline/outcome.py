"""The part of a result that lists and tables of jobs show."""

import operator
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from services.attacks.verdict import SUCCESS, Verdict
from services.pipeline.result import Result


class Outcome(BaseModel):
    """The verdict, the network's answers and the cost of a finished job."""

    model_config = ConfigDict(extra="forbid")

    outcome: Verdict = Field(description="what the attack came to; only `fooled` counts as a success")
    right_before: bool | None = Field(
        None, description="whether the answer to the original image was right; null if nobody knows"
    )
    fooled: bool = Field(description="whether the answer to an image inside the attack met the goal")
    verified: bool = Field(description="whether the answer to the perturbation rendered afresh meets the goal")
    stopped: str
    before: str = Field(description="label of the original image")
    before_confidence: float
    after: str = Field(description="label of the attacked image, rendered exactly")
    after_confidence: float
    answers: list[tuple[str, str]] = Field(
        [],
        exclude_if=operator.not_,
        description="of several questions attacked together: the answers to each, before and after; `before` and "
        "`after` then say whether all of them have left",
    )
    float_perceptibility: float = Field(description="p of the image before rounding, the paper's")
    perceptibility: float = Field(description="p of the image as saved, of 8 bits")
    perceptibility_limit: float | None = Field(
        None, exclude_if=lambda limit: limit is None, description="the largest p that the request allowed"
    )
    epsilon_bound: bool = Field(
        False,
        exclude_if=operator.not_,
        description="whether some values of the stored perturbation are at their ε: a search that held was bound by it",
    )
    steps: int
    queries: int
    seconds: float


def success(record: Outcome | Result) -> bool:
    """Whether an attack succeeded: a scene that the network had right is wrong when the adversary is rendered afresh.

    Every rate and count of successes uses this and nothing else.
    """
    return record.outcome == SUCCESS and record.verified


def outcome(result: Result) -> dict[str, Any]:
    """The outcome of a result as JSON data, which the database stores beside the result."""
    request: Any = result.spec
    return Outcome(
        outcome=result.outcome,
        right_before=result.right_before,
        fooled=result.fooled,
        verified=result.verified,
        stopped=result.stopped,
        before=result.original.label,
        before_confidence=result.original.confidence,
        after=result.attacked.label,
        after_confidence=result.attacked.confidence,
        answers=[(one.before.label, one.after.label) for one in result.questions] if len(result.questions) > 1 else [],
        float_perceptibility=result.float_perceptibility,
        perceptibility=result.perceptibility,
        perceptibility_limit=request["attack"].get("perceptibility"),
        epsilon_bound=result.epsilon_bound,
        steps=result.steps,
        queries=result.queries,
        seconds=result.seconds,
    ).model_dump(mode="json")
