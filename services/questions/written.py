"""A question as one text: its words, or its program as JSON.

Targets that answer questions take one text. Requests may have a program in its place, which is written here.
"""

import json

from services.errors import InvalidRequest
from services.questions.program import Program


def written(program: Program) -> str:
    """Returns a program as a text, JSON as in CLEVR's question files."""
    return json.dumps(program.written(), separators=(",", ":"))


def program_in(question: str) -> Program | None:
    """Returns the program that a text is, checked; None for a question in words.

    Raises InvalidProgram for a program that is invalid, InvalidRequest("question") for what begins as a program's JSON
    and is none.
    """
    if not question.lstrip().startswith("["):
        return None
    try:
        found = Program.read(json.loads(question))
    except (json.JSONDecodeError, RecursionError) as error:
        raise InvalidRequest("question", f"it begins as the JSON of a program and is none: {error}") from error
    found.check()
    return found
