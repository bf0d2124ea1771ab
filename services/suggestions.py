"""Names that a caller may have meant."""

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of an error message about an unknown name: "; did you mean 'a' or 'b'?", or nothing if none is close.

    At most three of the known names are suggested, the closest first.
    """
    close = get_close_matches(name, list(known), n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
