"""The part of a result that lists and tables of jobs show."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from services.pipeline.result import Result


class Outcome(BaseModel):
    """The verdict, the network's answers and the cost of a finished job."""

    model_config = ConfigDict(extra="forbid")

    fooled: bool
    verified: bool
    stopped: str
    before: str = Field(description="label of the original image")
    before_confidence: float
    after: str = Field(description="label of the attacked image, rendered exactly")
    after_confidence: float
    perceptibility: float
    steps: int
    queries: int
    seconds: float


def outcome(result: Result) -> dict[str, Any]:
    """The outcome of a result as JSON data, which the database stores beside the result."""
    return Outcome(
        fooled=result.fooled,
        verified=result.verified,
        stopped=result.stopped,
        before=result.original.label,
        before_confidence=result.original.confidence,
        after=result.attacked.label,
        after_confidence=result.attacked.confidence,
        perceptibility=result.perceptibility,
        steps=result.steps,
        queries=result.queries,
        seconds=result.seconds,
    ).model_dump(mode="json")
