"""The plan of a job, as `scene-attack plan` prints it, and the preview of a request. It needs no torch, so that the API
can import it.
"""

import operator

from pydantic import BaseModel, ConfigDict, Field

from services.analysis.records import Answer
from services.pipeline.result import Asked, JobWarning
from services.pipeline.spec import JobSpec
from services.rendering.plan import Plan


class JobPlan(Plan):
    """The renderer's plan of a job, with what limits its search, and its questions."""

    questions: tuple[Asked, ...] = Field(
        (), exclude_if=operator.not_, description="the questions about the image, with their programs"
    )


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FirstAnswer(_Record):
    """The network's answer to the scene before the attack."""

    question: str | None = Field(description="the question, in words or as its program; null for a network without one")
    answer: Answer


class Preview(_Record):
    """A request as it would run, and the network's answers to the image of its scene."""

    spec: JobSpec = Field(description="the request with the values of all fields filled in")
    answers: tuple[FirstAnswer, ...] = Field(description="one answer; of several questions one for each")
    warnings: tuple[JobWarning, ...] = Field(description="those that a job of this request would have")


class Cost(_Record):
    """What an attack costs, as far as it is known before. Both times were measured once, on this machine."""

    steps: int = Field(description="largest number of steps of an attempt; each has at least one image and one query")
    queries: int | None = Field(description="limit of network queries, if the request has one")
    image_seconds: float = Field(description="seconds of one image as the attack draws it, without its gradient")
    query_seconds: float = Field(description="seconds in which the network answers one image, without its gradient")
    least_seconds: float = Field(description="seconds of all steps if each had one image, one query and no gradient")


class PlannedCost(_Record):
    """The plan of a request, and its cost."""

    plan: JobPlan
    cost: Cost
