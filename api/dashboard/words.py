"""Formats numbers, times and reasons for the pages."""

import json
from datetime import datetime

FAILURES = {
    "non-finite": "An image, loss or gradient was not a number, so the attack could not go on.",
    "asset-missing": "Something the scene names is gone or damaged since the job was taken.",
    "out-of-memory": "The job needed more memory than a job may have.",
    "worker-lost": "The process running the job died more often than it may be restarted.",
    "timeout": "The job ran longer than a job may.",
    "internal": "Something in the program itself went wrong.",
}

STOPPED = {
    "verified": "it found an adversary that holds when rendered afresh",
    "steps": "its steps were used up",
    "queries": "its queries were used up",
    "seconds": "its time was used up",
}


def written(value: object) -> str:
    """Any part of a request or result as indented JSON."""
    return json.dumps(value, indent=2, ensure_ascii=False)


def failure(kind: str | None) -> str:
    """Why a job failed, in a sentence."""
    return FAILURES.get(kind or "", "The job could not be finished.")


def milli(value: float) -> str:
    """A perceptibility in thousandths, as in the paper's tables, e.g. "5.70"."""
    return f"{value * 1000:.2f}"


def small(value: float | str) -> str:
    """An error or a tolerance, e.g. "8.0e-04" or "0"; the tolerance "exact" stays as it is."""
    return value if isinstance(value, str) else f"{value:.1e}" if value else "0"


def percent(value: float) -> str:
    """A probability with a no-break space, e.g. "76.6 %"; below 0.1 % with two significant digits, e.g. "0.0021 %"."""
    return (
        f"{value:.1%}".replace("%", "\N{NO-BREAK SPACE}%")
        if value >= 0.001 or value == 0
        else f"{value * 100:.2g}\N{NO-BREAK SPACE}%"
    )


def seconds(value: float) -> str:
    """A duration given in seconds, e.g. "4.2 s", "3 min 20 s" or "2 h 5 min"."""
    if value < 60:
        return f"{value:.1f} s"
    whole = round(value)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def ago(then: datetime, now: datetime) -> str:
    """The time from `then` to `now`, e.g. "just now", "5 min ago", "3 h ago" or "2 days ago"."""
    minutes = int((now - then).total_seconds() // 60)
    if minutes < 1:
        return "just now"
    if minutes < 60:
        return f"{minutes} min ago"
    if minutes < 48 * 60:
        return f"{minutes // 60} h ago"
    return f"{minutes // (24 * 60)} days ago"
