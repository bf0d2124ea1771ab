"""Writes docs/models/iep-departures.md from the committed result of benchmarks.iep_departures.

Run after the benchmark: python -m benchmarks.iep_departures_page
"""

import json
from pathlib import Path
from typing import Any

from benchmarks.report import RESULTS

RESULT = RESULTS / "iep_departures.json"
PAGE = Path(__file__).parents[1] / "docs" / "models" / "iep-departures.md"


def page(result: dict[str, Any]) -> str:
    """The whole page as Markdown; its first row is the network as it is."""
    first, *_ = result["rows"]
    families = list(first["families"])
    heads = ("engine", "right", "95 % interval", "difference", "parameters", "processor minutes", *families)
    lines = [heads, [":---", *("---:" for _ in heads[1:])], *(_cells(row, first, families) for row in result["rows"])]
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    parts = [
        "# Departures of IEP's engine from the published network",
        f"The engine was trained with one departure undone at a time, {result['steps']:,} steps of {result['batch']} "
        f"questions about {result['scenes']:,} scenes, the same for all, on the features of the trunk that ships, and "
        "began with its engine's mask of all objects. The table has the share of right answers, in percent, to "
        "questions about scenes that these engines were not trained on, with true programs. The schedule is short, so "
        "the shares are lower than those of the network that ships, and a difference says what a departure is worth "
        "after so many steps.",
        "\n".join("| " + " | ".join(cells) + " |" for cells in lines),
        "Intervals are Wilson's. *3×3 convolutions* are in the residual blocks of modules that give a map. The module "
        "of `unique` is as those of other functions of one set, with its mask supervised.",
        f"<small>`{result['command']}`, seed {result['seed']}; {result['backend']}; {versions}; "
        f"{result['machine']}</small>",
    ]
    return "\n\n".join(parts) + "\n"


def _cells(row: dict[str, Any], first: dict[str, Any], families: list[str]) -> list[str]:
    overall = row["overall"]
    low, high = overall["wilson"]
    difference = 100 * (overall["share"] - first["overall"]["share"])
    return [
        row["variant"],
        _percent(overall["share"]),
        f"{_percent(low)} to {_percent(high)}",
        "" if row is first else f"{difference:+.1f}",
        f"{row['parameters']:,}",
        f"{row['seconds'] / 60:.1f}",
        *(_percent(row["families"][name]["share"]) for name in families),
    ]


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"


if __name__ == "__main__":
    PAGE.write_text(page(json.loads(RESULT.read_text("utf-8"))), "utf-8")
    print(f"written to {PAGE}")
