"""Texts that people write and read: what names, titles, tags and notes may not have, suggestions for unknown names,
numbers with a sign, and errors.

A control character steers a terminal, and a bidirectional override shows a text in another order than it has.
"""

import re
import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches

_OVERRIDES = "\u202a-\u202e\u2066-\u2069"
_CONTROLS = "\x00-\x08\x0b-\x1f\x7f-\x9f"
"""But for tab and newline, which a text of several lines may have."""
_IN_NO_LINE = re.compile(f"[{_CONTROLS}\t\n\u2028\u2029{_OVERRIDES}]")
_IN_NO_TEXT = re.compile(f"[{_CONTROLS}{_OVERRIDES}]")
_UNSEEN = ("Zs", "Zl", "Zp", "Cc", "Cf")
"""Unicode's categories of blanks and of characters without a picture."""


def line(text: str) -> str:
    """Returns a name, title or tag itself. Raises ValueError unless it is a line that can be seen."""
    _check(text, _IN_NO_LINE, "a line of text")
    if is_blank(text):
        raise ValueError("it is blank; write something that can be seen")
    return text


def line_or_nothing(text: str) -> str:
    """Returns a text that is empty or a `line`. Raises ValueError for others."""
    return line(text) if text else text


def paragraphs(text: str) -> str:
    """Returns a text of any number of lines itself. Raises ValueError for one that may not be."""
    _check(text, _IN_NO_TEXT, "a text")
    return text


def unfit(text: str) -> re.Match[str] | None:
    """The first character of a text that no line has; None if there is none."""
    return _IN_NO_LINE.search(text)


def is_blank(text: str) -> bool:
    """Whether nothing of a text can be seen."""
    return all(unicodedata.category(character) in _UNSEEN for character in text)


def character(match: re.Match[str]) -> str:
    """The name of a character: "U+001B"."""
    return f"U+{ord(match[0]):04X}"


def visible(text: str) -> str:
    """Returns a text for a terminal, with a replacement character for each that would steer it. Newlines stay."""
    return _IN_NO_TEXT.sub("\ufffd", text)


def escaped(json_text: str) -> str:
    """Returns JSON that says the same, with those characters as its escapes."""
    return _IN_NO_TEXT.sub(lambda match: f"\\u{ord(match[0]):04x}", json_text)


def _check(text: str, unfit: re.Pattern[str], what: str) -> None:
    if match := unfit.search(text):
        raise ValueError(
            f"it has the character {character(match)}; {what} has no control characters and no bidirectional overrides"
        )


MOST_SUGGESTED = 3
MAX_SUGGESTED_LETTERS = 100
"""Longest name that is compared with others; comparing takes time that grows with its length."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Returns the end of an error message about an unknown name: "; did you mean 'a' or 'b'?".

    At most three known names are suggested, the closest in spelling first. The result is empty if none is close.
    """
    names = closest(name, known)
    return f"; did you mean {' or '.join(map(repr, names))}?" if names else ""


def closest(name: str, known: Iterable[str]) -> list[str]:
    """Returns the known names that `did_you_mean` suggests for an unknown one, the closest first."""
    if len(name) > MAX_SUGGESTED_LETTERS:
        return []
    return get_close_matches(name, list(known), n=MOST_SUGGESTED, cutoff=0.5)


def there_are(name: str, known: Iterable[str]) -> str:
    """Returns the known names, and those that are similar to an unknown one: "there are a, b; did you mean 'a'?"."""
    names = list(known)
    return f"there are {', '.join(names)}{did_you_mean(name, names)}"


def signed(value: float, form: str) -> str:
    """A number with its sign in a format such as ".3f" or ".3g": "+0.120", "-3.4". A zero has no minus."""
    return f"{value:+z{form}}"


def small(value: float | str) -> str:
    """An error or a tolerance, e.g. "8.0e-04" or "0"; the tolerance "exact" stays as it is."""
    return value if isinstance(value, str) else f"{value:.1e}" if value else "0"
