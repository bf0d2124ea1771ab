"""Fields of requests that name something which may not be there: a mesh, an environment map, a material, a network.

Such a name is looked up while the request is validated, so that one answer names all that is wrong with it. It is so
only where the validation has a context that says how: a stored request stays readable when what it names has gone.
"""

from collections.abc import Callable, Mapping
from typing import Any, Literal

from pydantic import AfterValidator, ValidationInfo
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from services.errors import InvalidRequest

Kind = Literal["mesh", "map", "material", "target"]
Names = Mapping[Kind, Callable[[str], object]]
"""A context of a validation: functions that raise InvalidRequest for a name of the kind that there is not."""
UNKNOWN = "unknown_name"
"""The type of the error in pydantic's list."""


def reference(kind: Kind) -> AfterValidator:
    """Returns the annotation of a text that names something of a kind."""

    def check(value: str, info: ValidationInfo) -> str:
        if info.context:
            try:
                info.context[kind](value)
            except InvalidRequest as error:
                raise unknown(error.detail) from error
        return value

    return AfterValidator(check)


def unknown(detail: str) -> PydanticCustomError:
    """The error of a name that there is not, in words."""
    return PydanticCustomError(UNKNOWN, "{detail}", {"detail": detail})


def unknown_parts(model: str, errors: tuple[InvalidRequest, ...], within: str, value: Any) -> ValidationError:
    """The errors of names in the parts of the field `within` of a model, whose paths begin with that field.

    A part is a field that may hold one name or a list of them.
    """
    items = []
    for error in errors:
        part, _, index = error.field.removeprefix(f"{within}.").partition(".")
        loc = (part, "list", int(index)) if index else (part,)  # as pydantic does, with the alternative that was given
        items.append(InitErrorDetails(type=unknown(error.detail), loc=loc, input=value))
    return ValidationError.from_exception_data(model, items)
