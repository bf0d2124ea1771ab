"""Warnings of a job that may run but may not say what its sender expects."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

LOW_CONFIDENCE = 0.5
"""Confidence of the first answer below which a job is warned of it: all other labels together are as probable."""


class JobWarning(BaseModel):
    """A warning about one field of an accepted request."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    code: Literal["already-wrong", "truth-unknown", "low-confidence"]
    field: str = Field(description="the field of the request that it is about, e.g. `goal.truth`")
    text: str


def warnings(first: str, confidence: float, truth: tuple[str, ...], right: bool) -> tuple[JobWarning, ...]:
    """Returns the warnings about a network's first answer, given the true labels and whether the answer is right."""
    said = f"{first!r} ({confidence:.2f})"
    found = []
    if not truth:
        text = f"nobody has said what this scene shows; the network says {said}, and leaving that counts as “changed”"
        found.append(JobWarning(code="truth-unknown", field="goal.truth", text=text))
    elif not right:
        true = " or ".join(map(repr, truth))
        text = f"the network gets this scene wrong before the attack: it says {said}, not {true}; no success can follow"
        found.append(JobWarning(code="already-wrong", field="goal.truth", text=text))
    if confidence < LOW_CONFIDENCE:
        text = f"the network is unsure of this scene before the attack: it says {said}"
        found.append(JobWarning(code="low-confidence", field="scene", text=text))
    return tuple(found)
