"""The vocabulary of a released network: the words of questions, the functions of programs, and the answers."""

from dataclasses import dataclass
from functools import cached_property

from services.errors import InvalidRequest
from services.questions.answers import ANSWERS
from services.questions.text import MAX_WORDS, UnknownWord
from services.targets.iep.prefix import ARITIES, TOKENS

START, END = "<START>", "<END>"
KEPT, LEFT_OUT = ";,", "?."
"""Punctuation that is a word of its own, and punctuation that is none."""


@dataclass(frozen=True)
class Vocabulary:
    """The tokens in the order of their numbers; each list has some that are no word, no function and no answer.

    Raises ValueError if one of the functions or of the 28 answers is missing, or the ends of a question.
    """

    words: tuple[str, ...]
    functions: tuple[str, ...]
    answers: tuple[str, ...]

    def __post_init__(self) -> None:
        needed = {"words": (START, END), "functions": (START, *TOKENS), "answers": ANSWERS}
        for name, tokens in needed.items():
            missing = [token for token in tokens if token not in getattr(self, name)]
            if missing:
                raise ValueError(f"its {name} lack {missing[0]!r}")

    @cached_property
    def arities(self) -> tuple[int | None, ...]:
        """The number of inputs of each function; None for a token that is none."""
        known = dict(zip(TOKENS, ARITIES, strict=True))
        return tuple(known.get(token) for token in self.functions)

    @cached_property
    def answer_places(self) -> tuple[int, ...]:
        """The place of each of `ANSWERS` among the answers."""
        return tuple(self.answers.index(answer) for answer in ANSWERS)

    def encoded(self, question: str) -> list[int]:
        """Returns the numbers of a question's words, with those of start and end.

        The words know capitals; one that is unknown as it is written is looked up in small letters and with a capital.
        Raises UnknownWord for the first unknown one, and InvalidRequest("question") for none or more than MAX_WORDS.
        """
        for mark in KEPT:
            question = question.replace(mark, f" {mark} ")
        words = question.translate(dict.fromkeys(map(ord, LEFT_OUT))).split()
        if not 0 < len(words) <= MAX_WORDS:
            raise InvalidRequest("question", f"it has {len(words)} words; it needs 1 to {MAX_WORDS}")
        return [self._numbers[START], *map(self._number, words, range(len(words))), self._numbers[END]]

    def _number(self, word: str, place: int) -> int:
        for form in (word, word.lower(), word.capitalize()):
            if form in self._numbers and not form.startswith("<"):
                return self._numbers[form]
        raise UnknownWord(word, place)

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {word: number for number, word in enumerate(self.words)}
