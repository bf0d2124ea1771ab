"""Splits a question's text into words, and knows the words of CLEVR's language."""

import re
from collections.abc import Sequence
from typing import Any

from services.errors import InvalidRequest
from services.text import did_you_mean

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
    return [found.lower() for found in _TOKEN.findall(text)]


def encoded(text: str) -> list[int]:
    """Returns the index in WORDS of each word of a question.

    Raises UnknownWord for the first word that is not there, InvalidRequest("question") for a text without words or with
    more than MAX_WORDS.
    """
    found = _TOKEN.findall(text)
    if not 0 < len(found) <= MAX_WORDS:
        raise InvalidRequest("question", f"it has {len(found)} words; it needs 1 to {MAX_WORDS}")
    for index, token in enumerate(found):
        if token.lower() not in _INDEX:
            raise UnknownWord(token, index)
    return [_INDEX[token.lower()] for token in found]


def decoded(indices: Sequence[int]) -> list[str]:
    """Returns the words at these indices of WORDS."""
    return [WORDS[index] for index in indices]
