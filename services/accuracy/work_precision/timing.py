"""Seconds of a piece of work on a machine that does other things too."""

from collections.abc import Callable
from time import perf_counter


def shortest(work: Callable[[], object], enough: float) -> float:
    """Seconds of the shortest of up to nine runs, as many as fit into `enough` seconds; two at least, or one if it
    takes more than four times that. Warm up before."""
    found = [_seconds(work)]
    while len(found) < 9 and (sum(found) < enough or (len(found) < 2 and found[0] < 4 * enough)):
        found.append(_seconds(work))
    return min(found)


def _seconds(work: Callable[[], object]) -> float:
    began = perf_counter()
    work()
    return perf_counter() - began
