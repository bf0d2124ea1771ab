"""The step curves of a campaign's cells: verified successes against queries, seconds or perceptibility."""

from typing import Literal

from services.analysis.campaign_table import Cell, Corners

Along = Literal["queries", "seconds", "p"]
ALONG: dict[Along, str] = {"queries": "queries", "seconds": "seconds", "p": "p ×10⁻³"}
"""What the curves are drawn against, and the words for it."""


def corners(cell: Cell, along: Along) -> Corners:
    """The corners of a cell's curve; p is in thousandths."""
    in_thousandths = [(1000 * p, count) for p, count in cell.by_p]
    return {"queries": cell.by_queries, "seconds": cell.by_seconds, "p": in_thousandths}[along]


def end(cell: Cell, along: Along) -> float:
    """How far a cell's curve is known: the most work of any case, or the greatest p of a success; 0 if it has none."""
    most_p = 1000 * cell.by_p[-1][0] if cell.by_p else None
    return {"queries": cell.most_queries, "seconds": cell.most_seconds, "p": most_p}[along] or 0.0


def points(cell: Cell, along: Along, until: float) -> list[tuple[float, float]]:
    """The step curve of a cell with cases as points (work, share of the cases in per cent), up to the work `until`."""
    found, share = [(0.0, 0.0)], 0.0
    for at, count in corners(cell, along):
        found.append((at, share))
        share = 100 * count / cell.success.of
        found.append((at, share))
    return [*found, (until, share)]
