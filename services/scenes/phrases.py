"""Short phrases for people about an upload."""

from collections.abc import Iterable
from typing import NamedTuple

MOST = 40
"""Phrases of each kind; the last says how many more there would be."""
LENGTH = 300
"""Longest phrase."""


class Report(NamedTuple):
    """What a mesh shows, and what was dropped."""

    used: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()


def shortened(phrases: Iterable[str]) -> tuple[str, ...]:
    """Returns each phrase once, none longer than LENGTH and at most MOST."""
    found = ["".join(c if c.isprintable() else "\ufffd" for c in one[:LENGTH]) for one in dict.fromkeys(phrases)]
    return tuple(found if len(found) <= MOST else [*found[: MOST - 1], f"and {len(found) - MOST + 1} more"])
