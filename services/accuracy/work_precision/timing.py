"""Seconds of a piece of work, and their spread, on a machine that does other things too."""

from collections.abc import Callable
from time import perf_counter

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

LEAST, MOST = 5, 15
"""Repeats. Work that takes longer than LONG seconds is repeated three times."""
LONG = 1.0


class Times(BaseModel):
    """Seconds over several repeats after one that warms up."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    shortest: float
    lower: float = Field(description="first quartile")
    median: float
    upper: float = Field(description="third quartile")
    repeats: int


def repeated(work: Callable[[], object], enough: float) -> Times:
    """Times of LEAST to MOST repeats, as many as fit into `enough` seconds. Warm up before."""
    found = [_seconds(work)]
    least = LEAST if found[0] < LONG else 3
    while len(found) < least or (len(found) < MOST and sum(found) < enough):
        found.append(_seconds(work))
    lower, median, upper = (float(value) for value in np.quantile(found, (0.25, 0.5, 0.75)))
    return Times(shortest=min(found), lower=lower, median=median, upper=upper, repeats=len(found))


def _seconds(work: Callable[[], object]) -> float:
    began = perf_counter()
    work()
    return perf_counter() - began
