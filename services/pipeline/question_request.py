"""The parts of a request that ask a question: its words or its program, and a scene after CLEVR."""

from typing import Annotated, Any

from pydantic import AliasChoices, Field

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
    found = Program.read([call.model_dump() for call in calls])
    try:
        found.check()
    except InvalidProgram as error:
        raise ValueError(error.detail if error.node is None else f"{error.node}: {error.detail}") from error
    return found


def with_scene(data: dict[str, Any]) -> dict[str, Any]:
    """Fills in the scene of a request that gives it as CLEVR does: by a `record`, or by what to `generate`.

    Raises ValueError, which begins with the field that is wrong, and pydantic's error for fields of a wrong type.
    """
    if data.get("generate") is not None:
        if given := [name for name in ("scene", "record") if data.get(name) is not None]:
            raise InvalidRequest("generate", f"leave it out where {given[0]} is given")
        made = _Asked.model_validate({"generate": data["generate"]}).generate
        assert made is not None
        data = {**data, "generate": None, "record": made.record()}
    if data.get("record") is not None and data.get("scene") is None:
        record = _Asked.model_validate({"record": data["record"]}).record
        assert record is not None
        data = {**data, "record": record, "scene": scene_of(record)}
    return data


class _Asked(Model):
    record: SceneRecord | None = None
    generate: Generate | None = None
