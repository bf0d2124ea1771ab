"""A question in a request, by its words or its program and a scene after CLEVR, and its record in a result.

It needs no torch, so that the API can import it.
"""

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from services.analysis.records import Answer
from services.analysis.verdict import Verdict
from services.errors import InvalidRequest
from services.questions.program import MAX_NODES, InvalidProgram, Program
from services.scenes.clevr.description import Generate, scene_of
from services.scenes.clevr.records import SceneRecord
from services.scenes.description import Model

MOST_TEXT = 1000
"""Characters of a question."""
MOST_TOGETHER = 16
"""Questions about one image that are attacked together."""
Word = Annotated[str, Field(max_length=40)]


class Call(Model):
    """A function of a question's program, as in CLEVR's question files; its generator's words for the fields count."""

    function: Word = Field(
        validation_alias=AliasChoices("function", "type"), description="a function of the language, e.g. `filter_color`"
    )
    inputs: tuple[int, ...] = Field(
        (), max_length=8, description="numbers of the earlier functions whose outputs it takes, from 0"
    )
    value_inputs: tuple[Word, ...] = Field(
        (),
        max_length=8,
        validation_alias=AliasChoices("value_inputs", "side_inputs"),
        description='its values, e.g. ["red"]',
    )


Calls = Annotated[tuple[Call, ...], Field(max_length=MAX_NODES)]
Text = Annotated[str, Field(max_length=MOST_TEXT)]


def program(calls: tuple[Call, ...]) -> Program:
    """Returns the program of a request. Raises ValueError, which names the first invalid function by its number."""
    parsed = Program.read([call.model_dump() for call in calls])
    try:
        parsed.check()
    except InvalidProgram as error:
        raise ValueError(error.detail if error.node is None else f"{error.node}: {error.detail}") from error
    return parsed


def with_scene(data: dict[str, Any]) -> dict[str, Any]:
    """Fills in the scene of a request that gives it as CLEVR does: by a `record`, or by what to `generate`.

    Raises ValueError, which begins with the field that is wrong, and pydantic's error for fields of a wrong type.
    """
    if data.get("generate") is not None:
        if others := [name for name in ("scene", "record") if data.get(name) is not None]:
            raise InvalidRequest("generate", f"leave it out where {others[0]} is given")
        generator = _Asked.model_validate({"generate": data["generate"]}).generate
        assert generator is not None
        data = {**data, "generate": None, "record": generator.record()}
    if data.get("record") is not None and data.get("scene") is None:
        record = _Asked.model_validate({"record": data["record"]}).record
        assert record is not None
        data = {**data, "record": record, "scene": scene_of(record)}
    return data


class _Asked(Model):
    record: SceneRecord | None = None
    generate: Generate | None = None


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
