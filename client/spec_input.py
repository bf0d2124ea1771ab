"""Reads a spec from a file or from standard input."""

import sys
from pathlib import Path
from typing import Any

from services.errors import InvalidRequest
from services.strict import NotJson, read_json


def read(path: str, seed: int | None = None) -> dict[str, Any]:
    """The JSON object in the file `path`, or on standard input for "-". A given `seed` replaces the spec's seed.

    Raises InvalidRequest("SPEC") for a file that does not exist or does not hold a JSON object.
    """
    try:
        text = sys.stdin.read() if path == "-" else Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise InvalidRequest("SPEC", f"cannot read {path}: {reason}; give a JSON file, or - for stdin") from error
    try:
        data = read_json(text)
    except NotJson as error:
        raise InvalidRequest("SPEC", f"{path} cannot be read: {error}") from error
    if not isinstance(data, dict):
        raise InvalidRequest("SPEC", f'{path} holds a JSON {type(data).__name__}; a spec is an object: {{"scene": …}}')
    if seed is not None:
        data["seed"] = seed
    return data
