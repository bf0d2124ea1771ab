"""Names the invalid fields of a request, and says of each what was given and what would be valid.

The valid values and their meaning are read from the request's JSON schema, so that a new field needs no words here.
Where there is no such schema, `in_words` says what a pydantic error says in its own words.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from math import pi, radians
from typing import Any

from pydantic import BaseModel

from scene_attack.attacks.attack import ATTACKS
from scene_attack.errors import InvalidRequest, encodable
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.strict import UNKNOWN
from scene_attack.text import did_you_mean, there_are

Schema = Mapping[str, Any]

MAX_SHOWN = 60
"""Characters of a given value that a message shows."""
MAX_ERRORS = 100
"""Errors of a request that are looked at, of a list of many items that are all wrong."""
MAX_PART = 100
"""Characters of each part of a path: a client may have named a field by a megabyte."""
MAX_DETAIL = 1500
"""Characters of a message."""
_ANGLES = {pi / 2: "π/2", -pi / 2: "-π/2", 2 * pi: "2π", -2 * pi: "-2π"}
_OWN_WORDS = ("value_error", "assertion_error")
"""Types of errors whose message was written for the request's models."""


@dataclass(frozen=True)
class _Place:
    """A field of the request: its path as a client writes it, and its schema."""

    path: tuple[str, ...]
    schema: Schema | None
    """None for a field that does not exist."""
    parent: Schema
    description: str | None


def invalid_fields(items: Iterable[Mapping[str, Any]], model: type[BaseModel]) -> list[InvalidRequest]:
    """Returns one InvalidRequest for each invalid field of a model, in the order of `items`. Its path is as a client
    writes it, without pydantic's tags of unions.

    `items` are the dictionaries of `pydantic.ValidationError.errors()`, of which the first MAX_ERRORS count.
    A field with alternatives is reported once, with all of them; where an alternative has fields of its own that are
    invalid, those are reported instead.
    """
    schema, details = _schema(model, (*ATTACKS, *RENDERERS)), dict[tuple[str, ...], str]()
    for item in islice(items, MAX_ERRORS):
        path, detail = _error(item, schema)
        details.setdefault(path, detail)
    # an error of an enclosing field follows from the errors within it, or is of an alternative that was not meant
    enclosing = {path[:length] for path in details for length in range(len(path))}
    inner = [path for path in details if path not in enclosing]
    return [InvalidRequest(_path(path), _shortened(encodable(details[path]), MAX_DETAIL)) for path in inner]


@cache
def _schema(model: type[BaseModel], registered: tuple[str, ...]) -> Schema:  # noqa: ARG001 - on which it depends, too
    return model.model_json_schema()


def _path(parts: Sequence[str]) -> str:
    return ".".join(_shortened(encodable(part), MAX_PART) for part in parts) or "body"


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[:most]}…"


def _error(item: Mapping[str, Any], schema: Schema) -> tuple[tuple[str, ...], str]:
    loc, kind = tuple(item["loc"]), item["type"]
    if kind == "missing" and loc and isinstance(loc[-1], int):
        loc, kind = loc[:-1], "too_short"  # a list lacks this element
    place = _place(loc, schema)
    if kind == UNKNOWN:
        return place.path, item["ctx"]["detail"]
    if kind in _OWN_WORDS:
        detail = str(item["msg"]).removeprefix("Value error, ")
        name, colon, rest = detail.partition(": ")  # a check over several fields names its own
        return ((*place.path, name), rest) if colon else (place.path, detail)
    if kind == "union_tag_invalid":
        field, tags = str(item["ctx"]["discriminator"]).strip("'"), _tags(place)
        tag = str(item["ctx"]["tag"])
        return (*place.path, field), f"there is no {tag!r}; {there_are(tag, tags)}"
    if kind == "extra_forbidden":
        fields = list(place.parent.get("properties", ()))
        return place.path, f"there is no such field; {there_are(place.path[-1], fields)}"
    if place.schema is None:
        return place.path, in_words(item)
    meaning = "" if place.description is None else f": {place.description.partition('; ')[0]}"
    actual = "but is missing" if kind == "missing" else f"not {_given(item.get('input'))}"
    hint = looks_like_degrees(item.get("input"), place.description)
    example = "".join(f"; for example {json.dumps(one)}" for one in place.schema.get("examples", ())[:1])
    return place.path, f"must be {expected(place.schema, schema)}, {actual}{meaning}{hint}{example}"


def _place(loc: Sequence[int | str], schema: Schema) -> _Place:
    """The field at a pydantic location, in which a part after a field with alternatives names the alternative."""
    at: Schema | None = schema
    parent, tagged = schema, False
    path: tuple[str, ...] = ()
    description: str | None = None
    for part in loc:
        if at is not None:
            whole = _resolved(at, schema)
            chosen = whole.get("discriminator", {}).get("mapping", {}).get(part)
            if chosen is not None:
                at = {"$ref": chosen}
                continue
            options = _options(whole, schema)
            named = any(part in option.get("properties", ()) for option in options)  # no alternative: a validator chose
            if len(options) > 1 and not tagged and not named:
                tagged = True
                continue
            parent = next((option for option in options if _child(option, part) is not None), options[0])
            at = _child(parent, part)
        tagged = False
        path = (*path, str(part))
        inherited = description if isinstance(part, int) else None
        description = inherited if at is None else at.get("description", inherited)
    return _Place(path, None if at is None else _resolved(at, schema), parent, description)


def _child(schema: Schema, part: int | str) -> Schema | None:
    if isinstance(part, int):
        fixed: Sequence[Schema] = schema.get("prefixItems", ())
        return fixed[part] if part < len(fixed) else schema.get("items")
    others = schema.get("additionalProperties")
    child: Schema | None = schema.get("properties", {}).get(part, others if isinstance(others, dict) else None)
    return child


def _resolved(schema: Schema, root: Schema) -> Schema:
    while "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    return schema


def _options(schema: Schema, root: Schema) -> list[Schema]:
    """The alternatives of a field other than null; the field itself if it has only one."""
    options = [_resolved(option, root) for option in schema.get("anyOf", (schema,))]
    return [option for option in options if option.get("type") != "null"]


def _tags(place: _Place) -> list[str]:
    return list((place.schema or {}).get("discriminator", {}).get("mapping", {}))


def expected(schema: Schema, root: Schema) -> str:
    """The values that are valid for a schema, in words. `root` has the definitions that it refers to."""
    schema = _resolved(schema, root)
    if "anyOf" in schema:
        *most, last = (expected(option, root) for option in schema["anyOf"])
        return f"{', '.join(most)} or {last}"
    if "discriminator" in schema:
        chosen = schema["discriminator"]
        return f'an object, in which "{chosen["propertyName"]}" is one of {", ".join(chosen["mapping"])}'
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return f"one of {', '.join(map(json.dumps, schema['enum']))}"
    kind = schema.get("type")
    if kind == "null":
        return "null"
    if kind == "boolean":
        return "true or false"
    if kind in ("integer", "number"):
        return ("an integer" if kind == "integer" else "a number") + _range(schema)
    if kind == "string":
        low, high = schema.get("minLength"), schema.get("maxLength")
        return "a text" if high is None else f"a text of {low or 0} to {high} characters"
    if kind == "array":
        return _list(schema, root)
    if "properties" in schema:
        return f"an object with the fields {', '.join(schema['properties'])}"
    if isinstance(schema.get("additionalProperties"), dict):
        return f"an object in which each value is {expected(schema['additionalProperties'], root)}"
    return "an object"


def _list(schema: Schema, root: Schema) -> str:
    fixed = [expected(item, root) for item in schema.get("prefixItems", ())]
    if fixed and len(set(fixed)) == 1:
        return f"a list of {len(fixed)}, each {fixed[0]}"
    if fixed:
        return f"a list of {len(fixed)} ({', '.join(fixed)})"
    low, high = schema.get("minItems", 0), schema.get("maxItems")
    count = "" if high is None else f" of at most {high}" if not low else f" of {low} to {high}"
    return f"a list{count}, each {expected(schema.get('items', {}), root)}"


def _range(schema: Schema) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f" from {_number(low)} to {_number(high)}"
    limits = {"at least": low, "above": above, "at most": high, "below": below}
    words = " and ".join(f"{word} {_number(limit)}" for word, limit in limits.items() if limit is not None)
    return f" of {words}" if words.startswith("at") else f" {words}" if words else ""


def _number(value: float) -> str:
    return _ANGLES.get(value, str(value) if isinstance(value, int) else f"{value:g}")


def _given(value: Any) -> str:
    """The given value as JSON, shortened; an object is not shown."""
    if isinstance(value, Mapping):
        return "an object"
    # Each piece has a character or more: of a megabyte, or of a list in a list without end, the beginning is written.
    pieces = islice(json.JSONEncoder(ensure_ascii=False, default=str).iterencode(value), MAX_SHOWN + 1)
    return _shortened("".join(pieces), MAX_SHOWN)


_TEMPLATES = {
    "missing": "is required",
    "extra_forbidden": "there is no such field",
    "greater_than": "must be above {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be below {lt}",
    "less_than_equal": "must be at most {le}",
    "finite_number": "must be a finite number",
    "multiple_of": "must be a multiple of {multiple_of}",
    "string_too_short": "must have at least {min_length} characters",
    "string_too_long": "must have at most {max_length} characters",
    "string_pattern_mismatch": "must match the pattern {pattern}",
    "too_short": "must have at least {min_length} items",
    "too_long": "must have at most {max_length} items, not {actual_length}",
    "string_unicode": "must be a text, without half of a pair of UTF-16",
    "enum": "must be one of {expected}",
    "literal_error": "must be one of {expected}",
}
_KINDS = {
    "int": "an integer",
    "float": "a number",
    "bool": "true or false",
    "string": "a text",
    "list": "a list",
    "tuple": "a list",
    "dict": "an object",
    "model": "an object",
    "path": "a path",
    "bytes": "a file",
}
_WITHOUT_VALUE = ("missing", "extra_forbidden", "too_long", "string_unicode")
_TURN = 360
_NAMES = {30: "π/6", 45: "π/4", 60: "π/3", 90: "π/2", 180: "π", 270: "3π/2", 360: "2π"}


def in_words(item: Mapping[str, Any]) -> str:
    """An item of `pydantic.ValidationError.errors()` in words: what would be valid, and what was given."""
    kind, context, value = str(item["type"]), item.get("ctx", {}), item.get("input")
    if kind in ("value_error", "assertion_error"):
        return str(item["msg"]).partition(", ")[2] or str(item["msg"])
    expected = _KINDS.get(kind.partition("_")[0])
    if kind in _TEMPLATES:
        message = _TEMPLATES[kind].format(**context)
    else:
        message = f"must be {expected}" if expected else str(item["msg"]).replace("Input should be", "must be")
    if kind in _WITHOUT_VALUE or "input" not in item or isinstance(value, dict | bytes):
        return message
    near = ""
    if kind in ("enum", "literal_error") and isinstance(value, str):
        near = did_you_mean(
            value, (name.strip(" '") for name in str(context["expected"]).replace(" or ", ",").split(","))
        )
    return f"{message}, not {_given(value)}{near}"


def looks_like_degrees(value: object, description: str | None) -> str:
    """The hint "; 90 looks like degrees: π/2 is 1.5708", if a value of a field in radians looks like that; else "".

    More than a full turn of 2π, or a whole number of at least 5, is hardly meant in radians.
    """
    if description is None or "radians" not in description or isinstance(value, bool):
        return ""
    if not isinstance(value, int | float) or not 5 <= abs(value) <= 2 * _TURN:
        return ""
    name = _NAMES.get(round(abs(value))) if value == round(value) else None
    sign = "-" if value < 0 else ""
    words = f"{sign}{name} is" if name else f"{value:g}° is"
    return f"; {value:g} looks like degrees: {words} {radians(value):.5g}"
