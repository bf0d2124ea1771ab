"""Errors of pydantic where no schema of a request is at hand: no word of pydantic's own is left."""

from enum import StrEnum
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, TypeAdapter, ValidationError

from scene_attack.runs.field_errors import in_words, looks_like_degrees


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


@pytest.mark.parametrize(
    ("kind", "value", "said"),
    [
        (Annotated[int, Field(le=200)], 500, "must be at most 200, not 500"),
        (Annotated[int, Field(ge=1)], "0", 'must be at least 1, not "0"'),
        (Annotated[float, Field(gt=0, lt=1)], 1.0, "must be below 1.0, not 1.0"),
        (int, "many", 'must be an integer, not "many"'),
        (float, [], "must be a number, not []"),
        (bool, "perhaps", 'must be true or false, not "perhaps"'),
        (str, 3, "must be a text, not 3"),
        (Annotated[str, Field(max_length=2)], "abc", 'must have at most 2 characters, not "abc"'),
        (Colour, "rad", "must be one of 'red' or 'blue', not \"rad\"; did you mean 'red'?"),
        (Literal["cpu", "cuda"], "cuba", "must be one of 'cpu' or 'cuda', not \"cuba\"; did you mean 'cuda' or 'cpu'?"),
        (dict[str, int], 3, "must be an object, not 3"),
        (list[int], 3, "must be a list, not 3"),
    ],
)
def test_what_would_be_valid_and_what_was_given(kind: Any, value: object, said: str) -> None:
    with pytest.raises(ValidationError) as error:
        TypeAdapter(kind).validate_python(value)
    found = in_words(error.value.errors()[0])
    assert found == said
    assert "Input" not in found


RADIANS = "angle above the horizon, radians"


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (90, "; 90 looks like degrees: π/2 is 1.5708"),
        (-45, "; -45 looks like degrees: -π/4 is -0.7854"),
        (20, "; 20 looks like degrees: 20° is 0.34907"),
        (90.0, "; 90 looks like degrees: π/2 is 1.5708"),
        (3.2, ""),
        (1e6, ""),
        (True, ""),
        ("90", ""),
    ],
)
def test_degrees_are_recognised(value: object, said: str) -> None:
    assert looks_like_degrees(value, RADIANS) == said
    assert looks_like_degrees(value, "limit of run time in seconds") == ""
