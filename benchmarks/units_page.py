"""Writes docs/study/illumination-and-material.md from the committed result of benchmarks.units.

No figure of that page is typed by hand, but the paper's, which stand here. Run after the benchmark:
python -m benchmarks.units_page
"""

import json
from collections.abc import Iterator
from math import sqrt
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.report import RESULTS

PAGE = Path(__file__).parents[1] / "docs" / "study" / "illumination-and-material.md"
RESULT = "units_448.json"
LIMIT = 18 / 255
"""The paper's U: the largest change of a displayed value."""
IMAGES = 233
"""Images of the paper's table 1."""
ENOUGH = 30
"""Views of each network from which the page draws conclusions."""
PAPER: dict[str, dict[str, tuple[float, float, float | None]]] = {
    "AlexNet": {
        "image": (100.0, 5.7, None),
        "normals": (89.27, 10.8, None),
        "illumination": (29.61, 25.8, None),
        "material": (18.88, 25.8, None),
        "combined": (94.42, 18.1, None),
    },
    "ResNet-34": {
        "image": (99.57, 5.1, None),
        "normals": (88.41, 9.3, 6.3),
        "illumination": (14.16, 29.3, 1.6),
        "material": (3.43, 55.2, 0.0),
        "combined": (94.85, 16.4, None),
    },
}
"""Success in percent, mean p × 10⁻³, and pixels ever truncated, of table 1 and section 4.1.1."""
BESIDE = {"alexnet-furniture": "AlexNet", "resnet34-furniture": "ResNet-34"}
"""The paper's row beside which a network's is shown."""


def page() -> str:
    """The whole page as Markdown."""
    result: dict[str, Any] = json.loads((RESULTS / RESULT).read_text("utf-8"))
    parts = [INTRODUCTION, *_state(result), *_measured(result), *_bounds(result), *_combined(result), _foot(result)]
    return "\n\n".join(["# Illumination and material", *parts]) + "\n"


INTRODUCTION = """Attacks on light and on material succeed more rarely than attacks on normals, in the paper and here.
This page measures how much of that is the units of the two groups, which the paper does not give, and says where the
paper's own figures constrain each other. [Materials and light](../materials.md#units-of-l-and-m) defines the units."""


def _state(result: dict[str, Any]) -> Iterator[str]:
    fewest = min((row["success"]["of"] for row in result["rows"]), default=0)
    if fewest < ENOUGH or result["ended"] < result["planned"]:
        yield (
            f"**This page is of a trial: {result['ended']} of {result['planned']} attacks have ended, with {fewest} of "
            f"{ENOUGH} views. It shows what the benchmark measures and allows no conclusion.** "
            f"`python -m benchmarks.units` goes on with the rest, {ENOUGH} views of each network."
        )


def _measured(result: dict[str, Any]) -> Iterator[str]:
    yield "## Successes, p and truncated pixels by unit"
    yield (
        f"Each network has views of its own, which it gets right, in `{result['material']}`, {result['size']}² pixels. "
        "*Verified*: of the stored parameters rendered afresh. *In the loop*: of the truncated image, which is the "
        "paper's count. p is the mean over the successes so counted, × 10⁻³. A larger unit makes a weaker attack: a "
        "step of 1 in illumination is 1/unit of the map's mean, in material 1/unit of a natural logarithm. The "
        "renderer's own units are 10 and 30."
    )
    for target in dict.fromkeys(row["target"] for row in result["rows"]):
        rows = [row for row in result["rows"] if row["target"] == target]
        beside = BESIDE.get(target, "ResNet-34")
        lines = [_row(row, PAPER[beside].get(row["attack"].split(",")[0].removesuffix("_rgb"))) for row in rows]
        columns = ("attacked", "verified", "95 %", "p", "in the loop", "p in the loop", "truncated")
        paper = (f"{beside}: success", f"{beside}: p", f"{beside}: truncated")
        yield f"### {target}"
        yield "\n".join([_line((*columns, *paper)), "|" + "---|" * (len(columns) + len(paper)), *map(_line, lines)])


def _row(row: dict[str, Any], paper: tuple[float, float, float | None] | None) -> list[str]:
    own, loop = row["success"], row["loop_success"]
    there = paper or (None, None, None)
    return [
        row["attack"],
        f"{own['count']} of {own['of']}",
        "" if own["low"] is None else f"{100 * own['low']:.0f}–{100 * own['high']:.0f} %",
        _p(row["perceptibility"]),
        f"{loop['count']}",
        _p(row["loop_perceptibility"]),
        "" if row["truncated"] is None else f"{row['truncated']:.1f}",
        "" if there[0] is None else f"{there[0]:.1f} %",
        "" if there[1] is None else f"{there[1]:.1f}",
        "" if there[2] is None else f"{there[2]:.1f}",
    ]


def _bounds(result: dict[str, Any]) -> Iterator[str]:
    """What p and the truncation say of the share of the image that an object covers."""
    covered = result.get("coverage", [])
    yield "## What p says about coverage"
    yield (
        "Attacks on the scene change only pixels of the object, and no channel by more than U = 18/255, so "
        "p ≤ √3 · U · √c, where c is the share of the image that the object covers. For a mean p of several images the "
        "largest c among them has to be at least p² / (3 U²); if U limits the length of a pixel's change instead, "
        "p² / U²."
    )
    rows = []
    for network, groups in PAPER.items():
        for group, (success, p, truncated) in groups.items():
            if group == "image":  # which changes the ground too
                continue
            least = (p * 1e-3 / LIMIT) ** 2
            rows.append(
                [
                    f"{network}, {group}",
                    f"{success * IMAGES / 100:.0f}",
                    f"{p}",
                    "" if truncated is None else f"{truncated}",
                    f"{100 * least / 3:.1f} %",
                    f"{100 * least:.1f} %",
                ]
            )
    columns = ("paper", f"successes of {IMAGES}", "p × 10⁻³", "truncated pixels", "least c", "least c, by length")
    yield "\n".join([_line(columns), "|---" * len(columns) + "|", *map(_line, rows)])
    success, p, _ = PAPER["ResNet-34"]["material"]
    needed = (p * 1e-3 / LIMIT) ** 2
    shares = (
        f" The objects cover {100 * min(covered):.0f} % to {100 * max(covered):.0f} % of the {len(covered)} views "
        f"here, the median is {100 * median(covered):.0f} %; there p = {p}e-3 is a root mean square of "
        f"{255 * p * 1e-3 / sqrt(3 * median(covered)):.1f}/255 in each channel of the object."
        if covered
        else ""
    )
    yield (
        f"For material on ResNet-34 the paper has p = {p}e-3, over {success * IMAGES / 100:.0f} images, and no "
        f"truncated pixel. Even with every pixel of the object at the limit in every channel, that takes an object of "
        f"{100 * needed / 3:.0f} % of the image; with no pixel beyond the limit and most below it, a much larger one."
        f"{shares} So the two figures hold together only for objects that fill much of the frame and change evenly."
    )


def _combined(result: dict[str, Any]) -> Iterator[str]:
    """The combined attack beside normals alone."""
    yield "## Combined and normals"
    rows = [
        [f"paper, {network}", *(f"{groups[group][k]}" for group in ("normals", "combined") for k in (0, 1))]
        for network, groups in PAPER.items()
    ]
    for target in dict.fromkeys(row["target"] for row in result["rows"]):
        found = {row["attack"]: row for row in result["rows"] if row["target"] == target}
        if {"normals", "combined"} <= found.keys():
            own = [found[name] for name in ("normals", "combined")]
            rows.append([target, *(cell for row in own for cell in (_rate(row), _p(row["perceptibility"])))])
    columns = ("network", "normals: success %", "normals: p × 10⁻³", "combined: success %", "combined: p × 10⁻³")
    yield "\n".join([_line(columns), "|---" * len(columns) + "|", *map(_line, rows)])
    differences = [
        f"{network} √({groups['combined'][1]}² − {groups['normals'][1]}²) = "
        f"{sqrt(groups['combined'][1] ** 2 - groups['normals'][1] ** 2):.1f}"
        for network, groups in PAPER.items()
    ]
    yield (
        "A combined attack takes the steps of the normals' attack and beside them those of light and material, at the "
        "same learning rates, and stops at the first success. If it takes no more steps than normals alone, and the "
        "parts of p add in squares, light and material had by then a p of, × 10⁻³, "
        f"{' and '.join(differences)}: about half of what illumination alone has when it succeeds, within 120 steps. "
        "The paper's figures hold together if its illumination moves the image at that pace, or if its combined "
        "attacks take longer than those on normals alone, although they have more to choose from. It gives no steps by "
        "column."
    )


def _rate(row: dict[str, Any]) -> str:
    rate = row["success"]["rate"]
    return "" if rate is None else f"{100 * rate:.0f}"


def _p(value: float | None) -> str:
    return "" if value is None else f"{1e3 * value:.1f}"


def _line(cells: Any) -> str:
    return "| " + " | ".join(cells) + " |"


def _foot(result: dict[str, Any]) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    return (
        f"<small>`{result['command']}`, seed {result['seed']}; {result['backend']}; {versions}; {result['machine']}. "
        "Written by `python -m benchmarks.units_page`.</small>"
    )


if __name__ == "__main__":
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page(), "utf-8")
