"""The outcome of jobs as table rows (services.pipeline.outcome.Outcome, as JSON)."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from client.console import yes

COLUMNS = ("scene", "attack", "before", "after", "network", "verified", "p ×1e-3>", "queries>", "seconds>")


def cells(scene: str, attack: str, outcome: Mapping[str, Any]) -> list[str | Text]:
    """One row under COLUMNS."""
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
    """The network's answer "before" or "after", with its confidence: "grand piano 0.77"."""
    return f"{outcome[when]} {outcome[when + '_confidence']:.2f}"


def verdict(fooled: bool) -> Text:
    """The network was fooled, or it held."""
    return Text("fooled", style="bold magenta") if fooled else Text("held", style="bold blue")
