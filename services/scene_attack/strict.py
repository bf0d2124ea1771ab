"""JSON that others write: the base class of its data, what is wrong with a text and where, and names in it.

Numbers are numbers, the length of a list is checked before its items, and no text has the character U+0000, which
PostgreSQL cannot store. Pydantic's own strict mode would also refuse a list in the place of a tuple, and an object in
that of a model; JSON has nothing else to give. An integer of JSON counts as a number; a text or a boolean does not, and
1.0 is no integer.

Some fields name what may not be there: a mesh, an environment map, a material, a network. Such a name is looked up
while the request is validated, so that one answer names all that is wrong with it. It is so only where the validation
has a context that says how: a stored request stays readable when what it names has gone.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence, Sized
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationInfo,
    model_validator,
)
from pydantic_core import (
    CoreSchema,
    InitErrorDetails,
    PydanticCustomError,
    PydanticKnownError,
    ValidationError,
    core_schema,
)

from scene_attack.errors import InvalidRequest, shortened

MOST_FIELDS = 256
"""Fields of an object. No model has more, and no renderer more groups of parameters."""
LONG = 64
"""Items of a list up to which each wrong item is reported; of a list that may be longer, the first one is."""
MOST_NESTED = 64
"""Lists and objects within each other. No request needs a third of it; far more exhaust the stack of whoever reads."""


def is_nested_deeper(data: object, most: int = MOST_NESTED) -> bool:
    """Whether JSON data has more than `most` lists and objects within each other."""
    level = [data]
    for _ in range(most + 1):
        level = [
            part
            for item in level
            if isinstance(item, dict | list)
            for part in (item.values() if isinstance(item, dict) else item)
            if isinstance(part, dict | list)
        ]
        if not level:
            return False
    return True


def _strict(schema: Any, owner: type) -> Any:
    """Returns a part of a class's schema in which numbers are strict, and lists and objects are measured first."""
    if isinstance(schema, list | tuple):
        return type(schema)(_strict(part, owner) for part in schema)
    if not isinstance(schema, dict):
        return schema
    kind = schema.get("type")
    if kind == "model" and schema["cls"] is not owner and issubclass(schema["cls"], Strict):
        return schema  # it is strict already
    converted = {
        name: part if name in ("metadata", "default") else _strict(part, owner) for name, part in schema.items()
    }
    if kind in ("bool", "int", "float"):
        return converted | {"strict": True}
    if kind == "str":
        return core_schema.no_info_after_validator_function(_no_nul, converted)
    if kind == "dict":
        return core_schema.no_info_before_validator_function(_few, converted)
    if kind in ("tuple", "list") and "max_length" in converted:
        most = converted["max_length"]
        # pydantic counts a list while it validates the items
        return core_schema.no_info_before_validator_function(_at_most(most), converted | {"fail_fast": most > LONG})
    return converted


def _at_most(most: int) -> Callable[[Any], Any]:
    def counted(data: Any) -> Any:
        if isinstance(data, Sized) and len(data) > most:
            raise PydanticKnownError("too_long", {"field_type": "List", "max_length": most, "actual_length": len(data)})
        return data

    return counted


def _no_nul(text: str) -> str:
    if "\0" in text:
        raise PydanticCustomError("value_error", "it has the character U+0000, which no text may have")
    return text


def _few(data: Any) -> Any:
    if isinstance(data, Sized) and len(data) > MOST_FIELDS:
        raise PydanticCustomError("value_error", f"it has {len(data):,} fields, and may have {MOST_FIELDS}")
    return data


class Strict(BaseModel):
    """Base class of models whose data others write. Schemas of derived classes are made strict when they are built."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Pydantic's schema of the class, made strict."""
        schema: CoreSchema = _strict(handler(source), cls)
        return schema

    @model_validator(mode="before")
    @classmethod
    def _few_fields(cls, data: Any) -> Any:
        return _few(data) if isinstance(data, dict) else data


class Model(Strict):
    """Base class of every part of a request: strict, frozen, without unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def absent(value: object) -> bool:
    """Whether an optional field was not given, so that a description leaves it out, as before there was the field."""
    return value is None


def schema_of(models: Sequence[type[BaseModel]], handler: GetJsonSchemaHandler) -> dict[str, Any]:
    """The JSON schema of a field that takes one of these models, which were registered after the field's class."""
    if not models:
        return {"type": "null"}
    # of a tuple, so that each is referred to by its name
    found: list[dict[str, Any]] = handler(TypeAdapter(tuple[*models]).core_schema)["prefixItems"]  # type: ignore[valid-type]
    return found[0] if len(found) == 1 else {"anyOf": found}


Item = TypeVar("Item")
Held = TypeVar("Held")
Given = TypeVar("Given")

if TYPE_CHECKING:

    class Converted(Generic[Held, Given]):
        """What type checkers know of a field that holds something else than it may be given. They do not know what
        pydantic converts, but they do know descriptors.
        """

        def __get__(self, model: object, owner: type | None = None) -> Held: ...

        def __set__(self, model: object, given: Given) -> None: ...

    class Several(Converted[tuple[Item, ...], Sequence[Item]], Generic[Item]):
        """A field that takes a list or a tuple, and is a tuple."""
else:
    Several = tuple[Item, ...]


NESTED = f"it is nested deeper than {MOST_NESTED} lists and objects"


_WORDS = {
    "Expecting value": "a value of JSON is missing",
    "Expecting ',' delimiter": "a comma or a closing bracket is missing",
    "Expecting ':' delimiter": "a colon is missing",
    "Expecting property name enclosed in double quotes": "the name of a field, in double quotation marks, is missing",
    "Illegal trailing comma before end of object": "a comma has no field after it",
    "Illegal trailing comma before end of array": "a comma has no item after it",
    "Unterminated string starting at": "a text has no closing quotation mark; it begins",
    "Invalid control character at": "a text has a control character, which JSON writes as an escape such as \\n,",
    "Invalid \\escape": "a text has a backslash that begins no escape",
    "Invalid \\uXXXX escape": "a text has \\u without four hexadecimal digits",
    "Extra data": "something follows its end",
}


class NotJson(ValueError):
    """A text is no JSON, or JSON that is not read. The message is a sentence about "it"."""


def read_json(text: str | bytes) -> Any:
    """Returns what a JSON text says; bytes are UTF-8. A byte order mark may precede it. Raises NotJson."""
    try:
        data = json.loads((text.decode() if isinstance(text, bytes) else text).removeprefix("\ufeff"))
    except (ValueError, RecursionError) as error:
        raise NotJson(json_mistake(error)) from error
    if is_nested_deeper(data):
        raise NotJson(NESTED)
    return data


def json_mistake(error: Exception) -> str:
    """The sentence about a text whose reading ended in this error of Python's JSON parser."""
    if isinstance(error, RecursionError):
        return NESTED
    if isinstance(error, UnicodeDecodeError):
        return f"it is not UTF-8 text: byte {error.start + 1:,} cannot be"
    if isinstance(error, json.JSONDecodeError):
        return f"it is not JSON: {_WORDS.get(error.msg, error.msg)} at line {error.lineno}, column {error.colno}"
    if "digits" in str(error):
        return f"it has a number of more than {sys.get_int_max_str_digits():,} digits"
    return shortened(error)


Kind = Literal["mesh", "map", "material", "target", "scene"]
Names = Mapping[Kind, Callable[[str], Any]]
"""A context of a validation: functions that raise InvalidRequest for a name of the kind that there is not. That of
"scene" returns the scene in the upload of the name. Kinds that are left out are not looked up."""
UNKNOWN = "unknown_name"
"""The type of the error in pydantic's list."""


def reference(kind: Kind) -> AfterValidator:
    """Returns the annotation of a text that names something of a kind."""

    def check(value: str, info: ValidationInfo) -> str:
        if info.context and kind in info.context:
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
