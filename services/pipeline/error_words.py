"""Says in words what a pydantic error says in its own, where there is no schema of a request to read them from."""

import json
from collections.abc import Mapping
from math import radians
from typing import Any

from services.text import did_you_mean

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
_SHOWN = 60


def in_words(item: Mapping[str, Any]) -> str:
    """An item of `pydantic.ValidationError.errors()` in words: what would be valid, and what was given."""
    kind, context, given = str(item["type"]), item.get("ctx", {}), item.get("input")
    if kind in ("value_error", "assertion_error"):
        return str(item["msg"]).partition(", ")[2] or str(item["msg"])
    expected = _KINDS.get(kind.partition("_")[0])
    if kind in _TEMPLATES:
        said = _TEMPLATES[kind].format(**context)
    else:
        said = f"must be {expected}" if expected else str(item["msg"]).replace("Input should be", "must be")
    if kind in _WITHOUT_VALUE or "input" not in item or isinstance(given, dict | bytes):
        return said
    near = ""
    if kind in ("enum", "literal_error") and isinstance(given, str):
        near = did_you_mean(
            given, (one.strip(" '") for one in str(context["expected"]).replace(" or ", ",").split(","))
        )
    return f"{said}, not {_shown(given)}{near}"


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


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
