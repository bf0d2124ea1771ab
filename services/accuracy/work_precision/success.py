"""Work to a verified adversary: rates and medians of attacks, with confidence intervals and censored failures."""

from collections.abc import Iterator, Sequence
from math import inf, isfinite
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.work_precision.attack_runs import AttackRow
from services.rendering.plan import Tolerance
from services.statistics import wilson

RESAMPLES = 4000
SEED = 0


class Interval(BaseModel):
    """A median and its 95 % bootstrap interval. null: beyond the budget of the attacks, as too many of them held."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    median: float | None
    low: float | None
    high: float | None


class SuccessRow(BaseModel):
    """All attacks of one method on one set of groups within one tolerance."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    renderer: str
    method: str
    groups: tuple[str, ...]
    tolerance: Tolerance
    attacks: int
    verified: int
    rate: float
    rate_low: float = Field(description="95 % interval of the rate (Wilson 1927)")
    rate_high: float
    max_steps: int = Field(description="an attack that is not verified by then is censored there")
    queries: Interval
    seconds: Interval
    queries_per_success: float | None = Field(description="all queries, failures included, by the number of successes")
    seconds_per_success: float | None
    seconds_per_step: float


def median_interval(values: Sequence[float]) -> Interval:
    """The median of values, of which some may be infinite (censored), and its percentile bootstrap interval.

    Medians are order statistics (the lower of the two middle ones), so that an infinite value never enters a mean.
    """
    found = np.asarray(values, np.float64)
    random = np.random.default_rng(SEED)
    resampled = np.sort(found[random.integers(0, len(found), (RESAMPLES, len(found)))], axis=1)
    medians = np.sort(resampled[:, (len(found) - 1) // 2])
    low, high = medians[int(0.025 * RESAMPLES)], medians[int(0.975 * RESAMPLES)]
    numbers = (float(np.sort(found)[(len(found) - 1) // 2]), float(low), float(high))
    median, lowest, highest = (number if isfinite(number) else None for number in numbers)
    return Interval(median=median, low=lowest, high=highest)


def attacked_at_all(attacks: Sequence[AttackRow]) -> list[AttackRow]:
    """The attacks on scenes that the network got right; the others were not run."""
    return [row for row in attacks if row.outcome != "wrong to begin with"]


def success_rows(attacks: Sequence[AttackRow]) -> Iterator[SuccessRow]:
    """One row for each renderer, method, set of groups and tolerance."""
    rows = attacked_at_all(attacks)
    for kind in dict.fromkeys((r.renderer, r.method, r.groups, r.tolerance) for r in rows):
        own = [row for row in rows if (row.renderer, row.method, row.groups, row.tolerance) == kind]
        won = [row for row in own if row.outcome == "verified"]
        low, high = wilson(len(won), len(own))
        queries, seconds = (
            median_interval([float(getattr(r, work)) if r.outcome == "verified" else inf for r in own])
            for work in ("queries", "seconds")
        )
        yield SuccessRow(
            renderer=kind[0],
            method=kind[1],
            groups=kind[2],
            tolerance=kind[3],
            attacks=len(own),
            verified=len(won),
            rate=len(won) / len(own),
            rate_low=low,
            rate_high=high,
            max_steps=max(row.max_steps for row in own),
            queries=queries,
            seconds=seconds,
            queries_per_success=sum(r.queries for r in own) / len(won) if won else None,
            seconds_per_success=sum(r.seconds for r in own) / len(won) if won else None,
            seconds_per_step=sum(r.seconds for r in own) / max(1, sum(r.steps for r in own)),
        )


def curve(attacks: Sequence[AttackRow], along: Literal["queries", "seconds"]) -> Iterator[tuple[float, float]]:
    """Corners of a step curve: the work done and the share of the attacks verified by then. Attacks that held stay in
    the denominator; scenes that were wrong to begin with do not."""
    rows = attacked_at_all(attacks)
    won = sorted(float(getattr(row, along)) for row in rows if row.outcome == "verified")
    for number, at in enumerate(won, 1):
        yield at, number / len(rows)
