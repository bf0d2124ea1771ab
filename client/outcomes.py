"""Formats the outcomes of jobs as table rows."""

from collections.abc import Iterable, Mapping
from typing import Any, Literal

from rich.text import Text

from client.console import err, yes
from services.attacks.verdict import SUCCESS, WRONG_BEFORE, Verdict, held_within
from services.pipeline.outcome import Outcome
from services.pipeline.warning import JobWarning

STYLES = {"fooled": "bold magenta", "held": "bold blue"}
"""The colours of outcomes; the others are yellow, since they are neither a success nor a failure."""
COLUMNS = ("scene", "attack", "before", "after", "network", "verified", "p ×1e-3>", "p saved>", "queries>", "seconds>")
SPARE = ("p saved", "seconds", "queries", "verified", "before")
"""The columns that a narrow terminal does not show; a wide one, and --json, do."""


def cells(scene: str, attack: str, outcome: Outcome) -> list[str | Text]:
    """The cells of one table row, in the order of COLUMNS."""
    return [
        scene,
        attack,
        answer_cell(outcome, "before"),
        answer_cell(outcome, "after"),
        outcome_cell(outcome),
        verified(outcome),
        thousandths(outcome.float_perceptibility),
        thousandths(outcome.perceptibility),
        f"{outcome.queries:,}",
        f"{outcome.seconds:.1f}",
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


def answer_cell(outcome: Outcome, when: Literal["before", "after"]) -> str:
    """The network's answer "before" or "after" the attack, with its confidence, e.g. "grand piano 0.77".

    Of several questions the answers to each, e.g. "4, cyan, yes".
    """
    if outcome.answers:
        return ", ".join(before if when == "before" else after for before, after in outcome.answers)
    if when == "before":
        return f"{outcome.before} {outcome.before_confidence:.2f}"
    return f"{outcome.after} {outcome.after_confidence:.2f}"


def outcome_cell(outcome: Outcome) -> Text:
    """What the attack came to, and what bound a search that held."""
    bound = held_within(outcome.model_dump())
    return verdict(outcome.outcome).append(f" {bound}" if bound else "")


def verdict(word: Verdict) -> Text:
    """The word for what an attack came to, e.g. "fooled" or "held", in its colour."""
    return Text(word, style=STYLES.get(word, "yellow"))


def verified(outcome: Outcome) -> Text:
    """Whether the adversary was verified; nothing where the network was wrong before, since no success can follow."""
    return yes(None if outcome.outcome in WRONG_BEFORE else outcome.verified)


def successes(outcomes: Iterable[Outcome]) -> str:
    """How many attacks succeeded, of those on scenes that the network is known to have had right before."""
    counted = [outcome for outcome in outcomes if outcome.right_before]
    won = sum(outcome.outcome == SUCCESS and outcome.verified for outcome in counted)
    return f"Fooled and verified: {won} of {len(counted)} attacks on scenes that the network had right before"


def warn(warnings: Iterable[JobWarning]) -> None:
    """Prints the warnings of a job on stderr."""
    for warning in warnings:
        err().print(f"warning: {warning.field}: {warning.text}", markup=False, highlight=False)
