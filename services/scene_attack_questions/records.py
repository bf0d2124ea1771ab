"""The records of a question: as it is asked, and as a network answers it. This module does not import torch."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.analysis.records import Answer
from scene_attack.analysis.verdict import Verdict

if TYPE_CHECKING:
    pass

ATTENTION = "attention.safetensors"
"""Masks of the functions, float32 [h, w] in [0,1]; "0.3.before" is of function 3 of question 0."""
CHANGED = 0.5
"""Least change of a mask at a cell that counts as another object attended to: such a cell goes from 0 to 1 or back."""


class Attended(BaseModel):
    """The files that show what a function of a program attends to: grey images, white where an object of its set is."""

    model_config = ConfigDict(extra="forbid")

    node: int = Field(description="the function's number in the program, from 0")
    before: str
    after: str
    change: float = Field(
        description="sum over the cells of the absolute difference of the two masks: an object that enters or leaves "
        "the set changes it by about 1, as a mask is high in about one cell for each object"
    )
    cell_change: float = Field(
        description="largest absolute difference of the two masks at a cell, in [0,1]: about 1 if an object enters or "
        "leaves the set, and small if many cells change a little"
    )


class Asked(BaseModel):
    """A question about an image, and its right answer."""

    model_config = ConfigDict(extra="forbid")

    question: str | None = Field(description="the question in words; null if its program was given")
    program: list[dict[str, object]] = Field(description="as in CLEVR's question files")
    kind: str = Field(description="what the program asks for: boolean, integer, shape, size, color or material")
    right: str = Field(description="the right answer, by the scene's record")


class QuestionResult(Asked):
    """A question and its answers to the original and the attacked image."""

    right_after: str | None = Field(
        description="the right answer to the attacked scene, recomputed from its parameters; null if the question is "
        "ill-posed there. The outcome is judged by it"
    )
    before: Answer = Field(description="the network's answer to the original image")
    after: Answer = Field(description="the network's answer to the attacked image")
    before_of_kind: bool = Field(description="whether the answer before is of the kind that is asked for")
    after_of_kind: bool = Field(description="whether the answer after is")
    outcome: Verdict = Field(description="what the attack came to on this question")
    attention: list[Attended] = Field(
        description=f"of the functions whose result is a set or an object; the masks themselves are in {ATTENTION}"
    )


def first_changed(attention: Sequence[Attended]) -> Attended | None:
    """Returns the first function, in the program's order, whose mask changed by `CHANGED` or more at a cell.

    None if there is none. The functions before it attend to the same objects in both images.
    """
    return next((attended for attended in attention if attended.cell_change >= CHANGED), None)


def most_changed(attention: Sequence[Attended]) -> Attended | None:
    """Returns the function with the largest `change`, the first of equal ones; None if no attention changed."""
    most = max(attention, key=lambda attended: attended.change, default=None)
    return most if most is not None and most.change > 0 else None
