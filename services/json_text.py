"""Reads JSON that others write, and says in words what is wrong with it and where."""

import json
import sys
from typing import Any

from services.errors import shortened
from services.strict import MOST_NESTED, is_nested_deeper

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
