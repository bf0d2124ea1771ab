"""Prints analyses (services.analysis.records) as tables."""

from collections.abc import Iterator, Sequence

from rich.text import Text

from client.console import answer_text, out, table, yes
from client.fitted_table import FittedTable
from client.outcomes import thousandths, verdict
from services.analysis.records import (
    AdaptiveAttack,
    Analyses,
    Attribution,
    Interpretation,
    MinimalChange,
    Rerendering,
    Subset,
    Transferred,
)
from services.text import signed

STRONGEST = 20
"""Number of coordinates that a table shows, those of the largest Shapley values; the JSON has all."""

FIT_COLUMNS = ("ℓ1 at the start ×1e-3>", "ℓ1 at best ×1e-3>")


def print_subsets(rows: Sequence[Subset], attribution: Attribution | None) -> None:
    """Prints the table of subsets and the groups' Shapley values, if there are several groups."""
    if len(rows) <= 2:
        return
    columns = (
        "groups applied",
        "the network says",
        "confidence>",
        "goal's label>",
        "p ×1e-3>",
        "p saved>",
        "meets the goal",
    )
    cells: list[list[str | Text]] = [
        [
            " + ".join(row.groups) or "none",
            row.label,
            f"{row.confidence:.3f}",
            f"{row.goal_probability:.3g}",
            thousandths(row.float_perceptibility),
            thousandths(row.perceptibility),
            yes(row.fooled),
        ]
        for row in rows
    ]
    out().print(table(columns, cells, title="Subsets of the groups"))
    if attribution is not None:
        out().print(_attribution(attribution, "Shapley values of the groups"))


def print_analyses(found: Analyses) -> None:
    """Prints those analyses that were made."""
    for made in _tables(found):
        out().print(made)


def _tables(found: Analyses) -> Iterator[FittedTable]:
    if found.coordinates is not None:
        yield _attribution(found.coordinates, "Shapley values of the coordinates")
    if found.minimal is not None:
        yield from _minimal(found.minimal)
    if found.transfer is not None:
        yield _transfer(found.transfer)
    if found.interpretation is not None:
        yield _interpretation(found.interpretation)
    if found.rerendering is not None:
        yield rerendering_table(found.rerendering)
    if found.adaptive is not None:
        yield _adaptive(found.adaptive)


def _attribution(found: Attribution, title: str) -> FittedTable:
    errors, orders = found.log_odds.standard_error, found.orders
    how = f"mean over {orders} random orders" if errors is not None else "exact"
    by_size = sorted(range(len(found.parts)), key=lambda i: -abs(found.log_odds.shapley[i]))[:STRONGEST]
    rows = []
    for i in by_size if len(found.parts) > STRONGEST else range(len(found.parts)):
        error = "" if errors is None else f" ± {errors[i]:.3f}"
        rows.append(
            [
                found.parts[i],
                f"{signed(found.log_odds.shapley[i], '.3f')}{error}",
                f"{signed(100 * found.probability.shapley[i], '.2f')} %",
                _strongest_partner(found, i),
            ]
        )
    effect = signed(100 * found.probability.effect, ".2f")
    rows.append(["all", signed(found.log_odds.effect, ".3f"), f"{effect} %", ""])
    columns = ("part", "log-odds of the goal's label>", "its probability>", "strongest interaction (log-odds)")
    return table(columns, rows, title=f"{title}, {how}, {found.images:,} images")


def _strongest_partner(found: Attribution, part: int) -> str:
    matrix = found.log_odds.interactions
    if matrix is None or len(matrix) < 2:
        return ""
    other = max((j for j in range(len(matrix)) if j != part), key=lambda j: abs(matrix[part][j]))
    return f"{signed(matrix[part][other], '.3f')} with {found.parts[other]}"


def _minimal(found: MinimalChange) -> Iterator[FittedTable]:
    if found.smallest is None:
        title = f"Minimal change: none of {len(found.scan)} scales of the perturbation fools the network"
    else:
        steady = "" if found.fools_from is None else f"; every scanned scale from {found.fools_from:.4g} on fools"
        title = (
            f"Minimal change: {found.smallest.label} {found.smallest.confidence:.2f} at scale "
            f"{found.smallest.scale:.5g}, held at {found.holds_at:.5g}{steady}; p "
            f"{thousandths(found.smallest.float_perceptibility)}e-3, {found.images} images"
        )
    columns = ("group", "what", "measure", "minimal>", "stored>", "unit")
    least = [f"{change.value:.4g}" for change in found.change] or ["–"] * len(found.stored_change)
    rows = [
        [stored.group, stored.subject, stored.measure, value, f"{stored.value:.4g}", stored.unit]
        for value, stored in zip(least, found.stored_change, strict=True)
    ]
    yield table(columns, rows, title=title)


def _transfer(found: Sequence[Transferred]) -> FittedTable:
    rows: list[list[str | Text]] = [
        [
            one.target,
            one.renderer,
            answer_text(one.before),
            answer_text(one.after),
            verdict(one.outcome),
            yes(one.right_before),
            one.note,
        ]
        for one in found
    ]
    columns = ("target", "renderer", "original", "attacked", "network", "right before", "note")
    return table(columns, rows, title="Transfer")


def _interpretation(found: Interpretation) -> FittedTable:
    rows = [
        [
            one.optimiser,
            f"{one.rate:.0e}",
            f"{one.losses[0] * 1000:.3f}",
            f"{min(one.losses) * 1000:.3f}",
            answer_text(one.after),
            "yes" if one.after.label == found.image.label else "no",
        ]
        for one in found.fits
    ]
    columns = ("optimiser", "rate>", *FIT_COLUMNS, "label after", "attacked label kept")
    said = f"image: {answer_text(found.image)}, scene: {answer_text(found.scene)}"
    return table(columns, rows, title=f"Interpretation: fits of physical parameters to the image ({said})")


def rerendering_table(found: Rerendering) -> FittedTable:
    """The re-rendering defence as a table of one row."""
    row = [
        answer_text(found.before),
        answer_text(found.after),
        f"{found.losses[0] * 1000:.3f}",
        f"{min(found.losses) * 1000:.3f}",
        thousandths(found.distance),
    ]
    columns = ("image", "re-rendered", *FIT_COLUMNS, "p of the difference>")
    return table(columns, [row], title=f"Re-rendering defence: {found.optimiser}, rate {found.rate:g}")


def _adaptive(found: AdaptiveAttack) -> FittedTable:
    row: list[str | Text] = [
        yes(found.fooled),
        str(found.steps),
        answer_text(found.image),
        answer_text(found.rerendered),
        f"{found.goal_probability[0]:.3f} → {found.goal_probability[-1]:.3f}",
        thousandths(found.perceptibility),
    ]
    columns = (
        "defence fooled",
        "steps>",
        "attacked image",
        "re-rendered",
        "goal's label, re-rendered",
        "p saved ×1e-3>",
    )
    return table(columns, [row], title="Attack on pixels through the re-rendering defence")
