"""Compares the words of a question with a program that was made of them.

A generator of programs writes one for every text of known words, also for one that is no question of the language. What
such a text says is then missing in its program, or is there twice.
"""

import re
from collections import Counter

from services.questions.program import Program
from services.questions.templates.forms import RELATIONS, SYNONYMS
from services.questions.text import tokens
from services.scenes.clevr.records import ATTRIBUTES

_NAMES = {name: value for value, names in SYNONYMS.items() for name in names}
_VALUES = frozenset(RELATIONS).union(*ATTRIBUTES.values())
_ASKING = {
    "equal_integer": ("number",),
    "less_than": ("fewer", "less"),
    "greater_than": ("more", "greater"),
}
_OF_ATTRIBUTES = {
    "size": ("size", "how big"),
    "color": ("color",),
    "material": ("material", "made"),
    "shape": ("shape",),
}


def difference(question: str, program: Program) -> str | None:
    """Returns how a program differs from the words of its question, such as "the question has 'left' once, the program
    0 times".

    None if each colour, size, material, shape and relation is in the question as often as in the program, and the
    question has a word for what the program asks for: so it is for every question of the language with its program.
    """
    text = " ".join(tokens(question))
    said = Counter(filter(None, map(_value, re.sub("how big", "how", text).split())))
    asked = Counter(value for node in program.nodes for value in node.values)
    for value in sorted(said | asked):
        if said[value] != asked[value]:
            return f"the question has {value!r} {_times(said[value])}, the program {_times(asked[value])}"
    for node in program.nodes:
        words = (
            ("many", "number") if node is program.nodes[-1] and node.function == "count" else _words_of(node.function)
        )
        if words and not any(re.search(rf"\b{word}\b", text) for word in words):
            return f"the program has {node.function!r}, the question no {' or '.join(map(repr, words))}"
    return None


def _value(word: str) -> str | None:
    for form in (word, word.removesuffix("s")):
        value = _NAMES.get(form, form)
        if value in _VALUES:
            return value
    return None


def _words_of(function: str) -> tuple[str, ...]:
    """Returns the words of which a question has one if its program has this function; none: it needs no word."""
    if function in _ASKING:
        return _ASKING[function]
    kind, _, attribute = function.partition("_")
    if kind in ("query", "same", "equal") and attribute in _OF_ATTRIBUTES:
        return _OF_ATTRIBUTES[attribute]
    return ()


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
