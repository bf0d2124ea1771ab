"""Which parts of the perturbation mattered over many jobs: the mean of their Shapley values."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import stdev
from typing import Any

from services.statistics import NORMAL_95


@dataclass(frozen=True)
class PartMean:
    """A part of an attack: the mean Shapley value of the log-odds of the goal's label over `jobs` jobs.

    half: half the width of the mean's 95 % interval (normal approximation); None for a single job. first: the number of
    jobs in which no part moved the log-odds more.
    """

    target: str
    attack: str
    part: str
    jobs: int
    value: float
    half: float | None
    first: int


def part_means(attributions: Sequence[tuple[str, str, Mapping[str, Any]]]) -> list[PartMean]:
    """The means of (target, attack, attribution), in order of the target, attack and part that occur first.

    An attribution is that of services.analysis.records.Attribution as JSON data.
    """
    values: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    first: dict[tuple[str, str, str], int] = defaultdict(int)
    for target, attack, one in attributions:
        shapley = one["log_odds"]["shapley"]
        for part, value in zip(one["parts"], shapley, strict=True):
            values[target, attack, part].append(value)
            first[target, attack, part] += abs(value) == max(map(abs, shapley))
    return [
        PartMean(
            *at,
            jobs=len(own),
            value=sum(own) / len(own),
            half=NORMAL_95 * stdev(own) / len(own) ** 0.5 if len(own) > 1 else None,
            first=first[at],
        )
        for at, own in values.items()
    ]
