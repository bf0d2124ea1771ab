"""The 28 answers that a question can have, and their kinds."""

from services.errors import InvalidRequest
from services.questions.functions import FUNCTIONS, Type
from services.questions.program import Program
from services.scenes.clevr.records import ATTRIBUTES
from services.text import there_are

MAX_COUNT = 10
"""Largest number that is an answer."""

KINDS: dict[Type, tuple[str, ...]] = {
    "boolean": ("yes", "no"),
    "integer": tuple(str(n) for n in range(MAX_COUNT + 1)),
    "shape": ATTRIBUTES["shape"],
    "size": ATTRIBUTES["size"],
    "color": ATTRIBUTES["color"],
    "material": ATTRIBUTES["material"],
}
"""The answers of each kind; a kind is a type that a program may end in."""

ANSWERS: tuple[str, ...] = tuple(answer for kind in KINDS.values() for answer in kind)
"""All answers. Networks score them in this order."""

_KIND_OF = {answer: kind for kind, answers in KINDS.items() for answer in answers}


def kind_of(answer: str) -> Type:
    """Returns the kind of an answer. Raises InvalidRequest("answer") if it is none."""
    if answer not in _KIND_OF:
        raise InvalidRequest("answer", f"there is no answer {answer!r}; {there_are(answer, ANSWERS)}")
    return _KIND_OF[answer]


def kind_asked(program: Program) -> Type:
    """Returns the kind of answer that a valid program asks for."""
    return FUNCTIONS[program.nodes[-1].function].output
