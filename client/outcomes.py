"""Formats the outcomes of jobs (services.pipeline.outcome.Outcome, as JSON) as table rows."""

from collections.abc import Iterable, Mapping
from typing import Any

from rich.text import Text

from client.console import err, yes
from services.attacks.verdict import SUCCESS, WRONG_BEFORE, held_within, with_outcome

STYLES = {"fooled": "bold magenta", "held": "bold blue"}
"""The colours of outcomes; the others are yellow, since they are neither a success nor a failure."""
COLUMNS = ("scene", "attack", "before", "after", "network", "verified", "p ×1e-3>", "p saved>", "queries>", "seconds>")
SPARE = ("p saved", "seconds", "queries", "verified", "before")
"""The columns that a narrow terminal does not show; a wide one, and --json, do."""


def cells(scene: str, attack: str, outcome: Mapping[str, Any]) -> list[str | Text]:
    """The cells of one table row, in the order of COLUMNS."""
    return [
        scene,
        attack,
        answer_cell(outcome, "before"),
        answer_cell(outcome, "after"),
        verdict(outcome),
        verified(outcome),
        thousandths(outcome.get("float_perceptibility")),
        thousandths(outcome["perceptibility"]),
        f"{outcome['queries']:,}",
        f"{outcome['seconds']:.1f}",
    ]


def goal_line(spec: Mapping[str, Any]) -> str | None:
    """The goal of a full spec, if there are wrong answers that do not meet it; None for other goals."""
    goal = spec["goal"]
    if goal.get("reach") is not None:
        return f"Goal: the answer {goal['reach']!r}. Another wrong answer does not meet it."
    if goal.get("leave_kind"):
        return (
            "Goal: an answer of another kind than the question asks for. A wrong answer of its kind does not meet it."
        )
    return None


def thousandths(p: float | None) -> str:
    """A perceptibility in thousandths; a dash where it was not measured, as in results of version 0.1."""
    return "–" if p is None else f"{p * 1000:.2f}"


def answer_cell(outcome: Mapping[str, Any], when: str) -> str:
    """The network's answer "before" or "after" the attack, with its confidence, e.g. "grand piano 0.77".

    Of several questions the answers to each, e.g. "4, cyan, yes".
    """
    if several := outcome.get("answers"):
        return ", ".join(before if when == "before" else after for before, after in several)
    return f"{outcome[when]} {outcome[when + '_confidence']:.2f}"


def verdict(outcome: Mapping[str, Any]) -> Text:
    """The word for what the attack came to, e.g. "fooled" or "held", in its colour, and what bound a search."""
    whole = with_outcome(dict(outcome))
    text = Text(whole["outcome"], style=STYLES.get(whole["outcome"], "yellow"))
    bound = held_within(whole)
    return text.append(f" {bound}") if bound else text


def verified(outcome: Mapping[str, Any]) -> Text:
    """Whether the adversary was verified; nothing where the network was wrong before, since no success can follow."""
    return yes(None if with_outcome(dict(outcome))["outcome"] in WRONG_BEFORE else outcome["verified"])


def successes(outcomes: Iterable[Mapping[str, Any]]) -> str:
    """How many attacks succeeded, of those on scenes that the network is known to have had right before."""
    found = [with_outcome(dict(one)) for one in outcomes]
    counted = [one for one in found if one.get("right_before")]
    won = sum(one["outcome"] == SUCCESS and one["verified"] for one in counted)
    return f"Fooled and verified: {won} of {len(counted)} attacks on scenes that the network had right before"


def warn(warnings: Iterable[Mapping[str, Any]]) -> None:
    """Prints the warnings of a job on stderr."""
    for one in warnings:
        err().print(f"warning: {one['field']}: {one['text']}", markup=False, highlight=False)
