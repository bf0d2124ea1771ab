"""Formats the outcomes of jobs (services.pipeline.outcome.Outcome, as JSON) as table rows."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from client.console import yes

COLUMNS = ("scene", "attack", "before", "after", "network", "verified", "p ×1e-3>", "queries>", "seconds>")


def cells(scene: str, attack: str, outcome: Mapping[str, Any]) -> list[str | Text]:
    """The cells of one table row, in the order of COLUMNS."""
    return [
        scene,
        attack,
        answer_cell(outcome, "before"),
        answer_cell(outcome, "after"),
        verdict(outcome["fooled"]),
        yes(outcome["verified"]),
        f"{outcome['perceptibility'] * 1000:.2f}",
        f"{outcome['queries']:,}",
        f"{outcome['seconds']:.1f}",
    ]


def answer_cell(outcome: Mapping[str, Any], when: str) -> str:
    """The network's answer "before" or "after" the attack, with its confidence, e.g. "grand piano 0.77"."""
    return f"{outcome[when]} {outcome[when + '_confidence']:.2f}"


def verdict(fooled: bool) -> Text:
    """The word "fooled" or "held", in its colour."""
    return Text("fooled", style="bold magenta") if fooled else Text("held", style="bold blue")
