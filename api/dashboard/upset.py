"""Lays out an UpSet plot (Lex et al. 2014) of the subsets of an attack's groups, in an SVG of fixed size.

A column is a subset: its image, a bar of the probability of the goal's label, and a dot for each group that it has. A
row is a group: its name, and a bar of its Shapley value.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from services.pipeline.result import subset_image

LEFT, COLUMN, ROW = 230, 60, 30
"""Widths of the part with the groups and of a column, and height of a row, in SVG units."""
IMAGE, BAR, GAP = 54, 90, 12
"""Heights of the images and of the highest bar, and what is between the parts."""
SHAPLEY, ZERO = 40, 182
"""Width of the longest bar of a Shapley value on either side of zero, and the place of zero."""


@dataclass(frozen=True)
class Column:
    """A subset; positions are in SVG units."""

    x: float
    image: str
    """Name of its image among the job's files; empty if it was not kept."""
    words: str
    outcome: str
    met: bool
    """Whether the goal is met."""
    probability: float
    top: float
    dots: list[tuple[float, bool]]
    """Height of each group's dot, and whether the subset has the group."""
    line: tuple[float, float] | None
    """Heights of the first and last dot, if it has several groups."""


@dataclass(frozen=True)
class Group:
    """A group's row."""

    y: float
    words: str
    shapley: float | None
    start: float
    width: float


@dataclass(frozen=True)
class Upset:
    """The plot."""

    width: float
    height: float
    bars: float
    """Height of the line on which the bars stand."""
    columns: list[Column]
    groups: list[Group]


def upset(
    subsets: Sequence[Mapping[str, Any]],
    attribution: Mapping[str, Any] | None,
    words: Mapping[str, str],
    files: Sequence[str],
) -> Upset | None:
    """The plot of the rows of a table of subsets; None for fewer than two groups, of which there is nothing to tell.

    `words` has the name of each group on pages, in the order of the rows. `files` are the names of the job's files.
    """
    if len(words) < 2 or len(subsets) < 4:
        return None
    bars = GAP + IMAGE + GAP + BAR
    rows = {group: bars + GAP + ROW * (k + 0.5) for k, group in enumerate(words)}
    shapley: dict[str, float] = {}
    if attribution is not None:
        shapley = dict(zip(attribution["parts"], attribution["log_odds"]["shapley"], strict=True))
    largest = max((abs(value) for value in shapley.values()), default=0.0) or 1.0
    groups = []
    for group, name in words.items():
        value = shapley.get(group)
        length = SHAPLEY * (value or 0.0) / largest
        groups.append(Group(rows[group], name, value, ZERO + min(0.0, length), abs(length)))
    columns = [
        _column(k, one, len(subsets), rows, words, set(files), LEFT + COLUMN * (k + 0.5), bars)
        for k, one in enumerate(subsets)
    ]
    return Upset(LEFT + COLUMN * len(columns), bars + GAP + ROW * len(rows) + GAP, bars, columns, groups)


def _column(
    number: int,
    subset: Mapping[str, Any],
    of: int,
    rows: Mapping[str, float],
    words: Mapping[str, str],
    files: set[str],
    x: float,
    bars: float,
) -> Column:
    image = {0: "original.png", of - 1: "attacked.png"}.get(number, subset_image(number))
    has = [rows[group] for group in subset["groups"]]
    return Column(
        x=x,
        image=image if image in files else "",
        words=" + ".join(words[group] for group in subset["groups"]) or "none",
        outcome=subset["outcome"],
        met=subset["fooled"],
        probability=subset["goal_probability"],
        top=bars - BAR * subset["goal_probability"],
        dots=[(y, group in subset["groups"]) for group, y in rows.items()],
        line=(min(has), max(has)) if len(has) > 1 else None,
    )
