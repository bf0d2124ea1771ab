"""Texts that people write and others read, such as names, titles, tags and notes: what none of them may have.

A control character steers a terminal, and a bidirectional override shows a text in another order than it has.
"""

import re
import unicodedata

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


def character(found: re.Match[str]) -> str:
    """The name of a character: "U+001B"."""
    return f"U+{ord(found[0]):04X}"


def visible(text: str) -> str:
    """Returns a text for a terminal, with a replacement character for each that would steer it. Newlines stay."""
    return _IN_NO_TEXT.sub("\ufffd", text)


def escaped(json_text: str) -> str:
    """Returns JSON that says the same, with those characters as its escapes."""
    return _IN_NO_TEXT.sub(lambda found: f"\\u{ord(found[0]):04x}", json_text)


def _check(text: str, unfit: re.Pattern[str], what: str) -> None:
    if found := unfit.search(text):
        raise ValueError(
            f"it has the character {character(found)}; {what} has no control characters and no bidirectional overrides"
        )
