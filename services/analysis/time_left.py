"""Estimates the time that a campaign still takes, from the jobs that have ended."""

from collections import Counter
from collections.abc import Sequence

from services.analysis.campaign_table import Case


def time_left(planned: Sequence[tuple[str, str]], cases: Sequence[Case], workers: int = 1) -> float | None:
    """Seconds until all `planned` jobs, (target, attack) of each, have ended, with so many workers at once.

    A job takes the mean time of the ended ones of its target and attack, else of its attack, else of all; reused
    results are left out of the means, and every job left is taken for one that has to run. None before a job has ended.
    """
    timed = [(case.target, case.attack, case.run_seconds) for case in cases if not case.reused]
    known = [(target, attack, seconds) for target, attack, seconds in timed if seconds is not None]
    remaining = Counter(planned)
    remaining.subtract((case.target, case.attack) for case in cases)
    if not known:
        return None if any(remaining.values()) else 0.0
    left = 0.0
    for (target, attack), count in remaining.items():
        own = [s for t, a, s in known if (t, a) == (target, attack)]
        like = [s for _, a, s in known if a == attack]
        times = own or like or [s for *_, s in known]
        left += count * sum(times) / len(times)
    return left / max(1, workers)
