"""Suggests known names that are similar to an unknown name."""

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Returns the end of an error message about an unknown name: "; did you mean 'a' or 'b'?".

    At most three known names are suggested, the closest first; the result is empty if none is close.
    """
    close = get_close_matches(name, list(known), n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""


def there_are(name: str, known: Iterable[str]) -> str:
    """Returns the known names, and those that are similar to an unknown one: "there are a, b; did you mean 'a'?"."""
    names = list(known)
    return f"there are {', '.join(names)}{did_you_mean(name, names)}"
