"""The words of CLEVR's language: splits a question into them, and compares it with a program that was made of it.

A generator of programs writes one for every text of known words, also for one that is no question of the language. What
such a text says is then missing in its program, or is there twice.
"""

import re
from collections import Counter
from typing import Any

from scene_attack.errors import InvalidRequest
from scene_attack.text import did_you_mean
from scene_attack_questions.clevr.records import ATTRIBUTES
from scene_attack_questions.program import Program
from scene_attack_questions.wording import RELATIONS, SYNONYMS

MAX_WORDS = 128
"""Longest question that is accepted; CLEVR's have at most 43 words."""

WORDS = (
    *("a", "an", "and", "another", "any", "anything", "are", "as", "ball", "balls", "behind", "big", "block", "blocks"),
    *("blue", "both", "brown", "color", "cube", "cubes", "cyan", "cylinder", "cylinders", "do", "does", "either"),
    *("else", "equal", "fewer", "front", "gray", "greater", "green", "has", "have", "how", "in", "is", "it", "its"),
    *("large", "left", "less", "made", "many", "material", "matte", "metal", "metallic", "more", "number", "object"),
    *("objects", "of", "on", "or", "other", "purple", "red", "right", "rubber", "same", "shape", "shiny", "side"),
    *("size", "small", "sphere", "spheres", "than", "that", "the", "there", "thing", "things", "tiny", "to"),
    *("visible", "what", "yellow", ";"),
)
"""All words of the language and the semicolon, in a fixed order: a trained network refers to them by their index."""

_INDEX = {known: index for index, known in enumerate(WORDS)}
_TOKEN = re.compile(r";|[^\s;?.!,]+")


class UnknownWord(InvalidRequest):
    """A question has a word that the language does not know: `word`, at place `index` among its words, from 0."""

    def __init__(self, word: str, index: int) -> None:
        super().__init__("question", f"word {index + 1}, {word!r}, is not known{did_you_mean(word.lower(), WORDS)}")
        self.word = word
        self.index = index

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.word, self.index)


def tokens(text: str) -> list[str]:
    """Returns the words of a text in lower case, and its semicolons; other punctuation is left out."""
    return [token.lower() for token in _TOKEN.findall(text)]


def encoded(text: str) -> list[int]:
    """Returns the index in WORDS of each word of a question.

    Raises UnknownWord for the first word that is not there, InvalidRequest("question") for a text without words or with
    more than MAX_WORDS.
    """
    words = _TOKEN.findall(text)
    if not 0 < len(words) <= MAX_WORDS:
        raise InvalidRequest("question", f"it has {len(words)} words; it needs 1 to {MAX_WORDS}")
    for index, token in enumerate(words):
        if token.lower() not in _INDEX:
            raise UnknownWord(token, index)
    return [_INDEX[token.lower()] for token in words]


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
    in_question = Counter(filter(None, map(_value, re.sub("how big", "how", text).split())))
    in_program = Counter(value for node in program.nodes for value in node.values)
    for value in sorted(in_question | in_program):
        if in_question[value] != in_program[value]:
            return f"the question has {value!r} {_times(in_question[value])}, the program {_times(in_program[value])}"
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
