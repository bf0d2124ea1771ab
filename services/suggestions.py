"""Suggests known names that are similar to an unknown name, in spelling or in sound."""

import re
from collections.abc import Iterable
from difflib import get_close_matches

MOST = 3
MAX_LETTERS = 100
"""Longest name that is compared with others; comparing takes time that grows with its length."""
_CLASSES = {
    letter: code for code, letters in enumerate(("bfpv", "cgjkqsxz", "dt", "l", "mn", "r"), 1) for letter in letters
}
"""Consonants that sound alike, as Soundex (Russell 1918) has them."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Returns the end of an error message about an unknown name: "; did you mean 'a' or 'b'?".

    At most three known names are suggested: the closest in spelling first, and at least one that sounds like it, if
    there is one. The result is empty if none is close.
    """
    found = closest(name, known)
    return f"; did you mean {' or '.join(map(repr, found))}?" if found else ""


def closest(name: str, known: Iterable[str]) -> list[str]:
    """Returns the known names that `did_you_mean` suggests for an unknown one, the closest first."""
    if len(name) > MAX_LETTERS:
        return []
    names = list(known)
    close = get_close_matches(name, names, n=MOST, cutoff=0.5)
    heard = [one for one in _sounding_like(name, names) if one not in close][:1]
    return [*close[: MOST - len(heard)], *heard]


def there_are(name: str, known: Iterable[str]) -> str:
    """Returns the known names, and those that are similar to an unknown one: "there are a, b; did you mean 'a'?"."""
    names = list(known)
    return f"there are {', '.join(names)}{did_you_mean(name, names)}"


def _sounding_like(name: str, known: Iterable[str]) -> list[str]:
    """The known names that sound like a name, whole or without their folder."""
    wanted = {sound(name), sound(name.rpartition("/")[2])}
    wanted = {one for one in wanted if len(one) > 1}  # nearly everything sounds like a single consonant
    return [one for one in known if {sound(one), sound(one.rpartition("/")[2])} & wanted]


def sound(word: str) -> str:
    """Returns the classes of a word's consonants, without vowels and repetitions; digits stay as "#" and the digit."""
    word = re.sub(r"[^a-z0-9]", "", word.casefold().replace("ph", "f"))
    found = ""
    for letter in word:
        code = f"#{letter}" if letter.isdigit() else str(_CLASSES.get(letter, ""))
        if code and not found.endswith(code):
            found += code
    return found
