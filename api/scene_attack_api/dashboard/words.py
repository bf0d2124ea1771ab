"""Formats numbers, times and reasons for the pages."""

import json
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from scene_attack.analysis.verdict import WRONG_BEFORE as WRONG_BEFORE
from scene_attack.analysis.verdict import held_within as held_within
from scene_attack.text import signed
from scene_attack.text import small as small

FAILURES = {
    "non-finite": "An image, loss or gradient was not a number, so the attack could not go on.",
    "asset-missing": "Something the scene names is gone or damaged since the job was taken.",
    "out-of-memory": "The job needed more memory than a job may have.",
    "worker-lost": "The process running the job died more often than it may be restarted.",
    "timeout": "The job ran longer than a job may.",
    "target-unreachable": "The network behind a URL did not answer.",
    "internal": "Something in the program itself went wrong.",
}

HAPPENED = {"running": "started", "cancelling": "asked to stop"}
"""The words for the time at which a job came into a state, where they are not the state's name."""

PHASES = {
    "loading": "Preparing the scene, its plan and the attack",
    "attacking": "Attacking",
    "analysing": "Measuring the result",
}

OUTCOMES = {
    "fooled": "The network was fooled",
    "changed": "The network's answer changed, and nobody has said which answer is right",
    "became-right": "The network was wrong before the attack and became right",
    "still-wrong": "The network was wrong before the attack and still is, which is no success",
    "held": "The network held",
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
    """Returns the reason why a job failed, in a sentence."""
    return FAILURES.get(kind or "", "The job could not be finished.")


def milli(value: float) -> str:
    """A perceptibility in thousandths, as in the paper's tables, e.g. "5.70"."""
    return f"{value * 1000:.2f}"


def both_p(record: Mapping[str, Any]) -> str:
    """The two p of a result, an outcome or a subset in thousandths, the paper's first: "3.46 (6.80 as saved)".

    A line may break before the parenthesis, nowhere else.
    """
    saved = f"{milli(record['perceptibility'])} as saved".replace(" ", "\N{NO-BREAK SPACE}")
    return f"{milli(record['float_perceptibility'])} ({saved})"


def strongest_interaction(attribution: Mapping[str, Any], part: int) -> str:
    """A part's largest interaction and its partner, e.g. "-0.075 with rotation"; empty if there are none."""
    matrix = attribution["log_odds"]["interactions"]
    if not matrix or len(matrix) < 2:
        return ""
    other = max((j for j in range(len(matrix)) if j != part), key=lambda j: abs(matrix[part][j]))
    return f"{signed(matrix[part][other], '.3f')} with {attribution['parts'][other]}"


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
        return f"{value:.1f}\N{NO-BREAK SPACE}s"
    whole = round(value)
    if whole < 3600:
        return f"{whole // 60}\N{NO-BREAK SPACE}min {whole % 60}\N{NO-BREAK SPACE}s"
    return f"{whole // 3600}\N{NO-BREAK SPACE}h {whole % 3600 // 60}\N{NO-BREAK SPACE}min"


def count(number: int, thing: str, things: str | None = None) -> str:
    """A number of things, e.g. "1 step", "2,000 steps"; `things` is the plural if it is not `thing` with an s."""
    return f"{number:,}\N{NO-BREAK SPACE}{thing if number == 1 else things or thing + 's'}"


def setting(value: object) -> str:
    """A setting that was measured when the attack started, e.g. "color 0.0003, rotation 0.01", "1.5e-05" or "none"."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {setting(part)}" for name, part in value.items()) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(map(setting, value)) or "none"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


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
