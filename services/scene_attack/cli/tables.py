"""Text tables of a job's results: its outcome, its warnings and its analyses."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from rich.text import Text

from scene_attack.analysis.records import (
    AdaptiveAttack,
    Analyses,
    Attribution,
    HeldOver,
    Interpretation,
    MinimalChange,
    Rerendering,
    SecondOpinion,
    Subset,
    Transferred,
)
from scene_attack.analysis.verdict import SUCCESS, WRONG_BEFORE, Verdict, held_within
from scene_attack.cli.console import FittedTable, answer_text, remark, say, yes
from scene_attack.runs.result import JobWarning, Outcome
from scene_attack.runs.spec import asked_of
from scene_attack.runs.task_parts import Part
from scene_attack.text import signed

OUTCOME_STYLES = {"fooled": "bold magenta", "held": "bold blue"}
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
    asked = asked_of(spec)
    return None if asked is None or asked.goal is None else f"Goal: {asked.goal}"


def thousandths(p: float) -> str:
    """A perceptibility in thousandths."""
    return f"{p * 1000:.2f}"


def answer_cell(outcome: Outcome, when: Literal["before", "after"]) -> str:
    """The network's answer "before" or "after" the attack, with its confidence, e.g. "grand piano 0.77".

    Of several that are attacked together each, e.g. "4, cyan, yes".
    """
    if outcome.answers:
        return ", ".join(before if when == "before" else after for before, after in outcome.answers)
    if when == "before":
        return f"{outcome.before} {outcome.before_confidence:.2f}"
    return f"{outcome.after} {outcome.after_confidence:.2f}"


def outcome_cell(outcome: Outcome) -> Text:
    """The outcome of the attack, and the limit of a search that held."""
    bound = held_within(outcome.model_dump())
    return verdict(outcome.outcome).append(f" {bound}" if bound else "")


def verdict(word: Verdict) -> Text:
    """The outcome of an attack, e.g. "fooled" or "held", in its colour."""
    return Text(word, style=OUTCOME_STYLES.get(word, "yellow"))


def verified(outcome: Outcome) -> Text:
    """Whether the adversary was verified; nothing where the network was wrong before, since no success can follow."""
    return yes(None if outcome.outcome in WRONG_BEFORE else outcome.verified)


def successes(outcomes: Iterable[Outcome]) -> str:
    """Number of successful attacks, out of those on scenes that the network is known to have had right before."""
    counted = [outcome for outcome in outcomes if outcome.right_before]
    won = sum(outcome.outcome == SUCCESS and outcome.verified for outcome in counted)
    return f"Fooled and verified: {won} of {len(counted)} attacks on scenes that the network had right before"


def warn(warnings: Iterable[JobWarning]) -> None:
    """Prints the warnings of a job on stderr."""
    for warning in warnings:
        remark(f"warning: {warning.field}: {warning.text}")


STRONGEST = 20
"""Number of coordinates that a table shows, those of the largest Shapley values; the JSON has all."""

FIT_COLUMNS = ("ℓ1 at the start ×1e-3>", "ℓ1 at best ×1e-3>")


def print_subsets(rows: Sequence[Subset], attribution: Attribution) -> None:
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
    say(FittedTable(columns, cells, title="Subsets of the groups"))
    say(_attribution(attribution, "Shapley values of the groups"))


def print_analyses(found: Analyses) -> None:
    """Prints those analyses that were made."""
    say(*_analysis_tables(found))


def _analysis_tables(analyses: Analyses) -> Iterator[FittedTable]:
    if analyses.coordinates is not None:
        yield _attribution(analyses.coordinates, "Shapley values of the coordinates")
    if analyses.minimal is not None:
        yield from _minimal(analyses.minimal)
    if analyses.transfer is not None:
        yield _transfer(analyses.transfer)
    if analyses.second_opinion is not None:
        yield _second_opinion(analyses.second_opinion)
    if analyses.survival is not None:
        yield _survival(analyses.survival)
    if analyses.interpretation is not None:
        yield _interpretation(analyses.interpretation)
    if analyses.rerendering is not None:
        yield rerendering_table(analyses.rerendering)
    if analyses.adaptive is not None:
        yield _adaptive(analyses.adaptive)


def _attribution(attribution: Attribution, title: str) -> FittedTable:
    errors, orders = attribution.log_odds.standard_error, attribution.orders
    how = f"mean over {orders} random orders" if errors is not None else "exact"
    by_size = sorted(range(len(attribution.parts)), key=lambda i: -abs(attribution.log_odds.shapley[i]))[:STRONGEST]
    rows = []
    for i in by_size if len(attribution.parts) > STRONGEST else range(len(attribution.parts)):
        error = "" if errors is None else f" ± {errors[i]:.3f}"
        rows.append(
            [
                attribution.parts[i],
                f"{signed(attribution.log_odds.shapley[i], '.3f')}{error}",
                f"{signed(100 * attribution.probability.shapley[i], '.2f')} %",
                _strongest_partner(attribution, i),
            ]
        )
    effect = signed(100 * attribution.probability.effect, ".2f")
    rows.append(["all", signed(attribution.log_odds.effect, ".3f"), f"{effect} %", ""])
    columns = ("part", "log-odds of the goal's label>", "its probability>", "strongest interaction (log-odds)")
    return FittedTable(columns, rows, title=f"{title}, {how}, {attribution.images:,} images")


def _strongest_partner(attribution: Attribution, part: int) -> str:
    matrix = attribution.log_odds.interactions
    if matrix is None or len(matrix) < 2:
        return ""
    other = max((j for j in range(len(matrix)) if j != part), key=lambda j: abs(matrix[part][j]))
    return f"{signed(matrix[part][other], '.3f')} with {attribution.parts[other]}"


def _minimal(minimal: MinimalChange) -> Iterator[FittedTable]:
    if minimal.smallest is None:
        title = f"Minimal change: none of {len(minimal.scan)} scales of the perturbation fools the network"
    else:
        steady = "" if minimal.fools_from is None else f"; every scanned scale from {minimal.fools_from:.4g} on fools"
        title = (
            f"Minimal change: {minimal.smallest.label} {minimal.smallest.confidence:.2f} at scale "
            f"{minimal.smallest.scale:.5g}, held at {minimal.holds_at:.5g}{steady}; p "
            f"{thousandths(minimal.smallest.float_perceptibility)}e-3, {minimal.images} images"
        )
    columns = ("group", "what", "measure", "minimal>", "stored>", "unit")
    least = [f"{change.value:.4g}" for change in minimal.change] or ["–"] * len(minimal.stored_change)
    rows = [
        [stored.group, stored.subject, stored.measure, value, f"{stored.value:.4g}", stored.unit]
        for value, stored in zip(least, minimal.stored_change, strict=True)
    ]
    yield FittedTable(columns, rows, title=title)


def _transfer(transfers: Sequence[Transferred]) -> FittedTable:
    rows: list[list[str | Text]] = [
        [
            transfer.target,
            answer_text(transfer.before),
            answer_text(transfer.after),
            verdict(transfer.outcome),
            yes(transfer.right_before),
        ]
        for transfer in transfers
    ]
    columns = ("target", "original", "attacked", "network", "right before")
    return FittedTable(columns, rows, title="Transfer")


def _second_opinion(opinions: Sequence[SecondOpinion]) -> FittedTable:
    rows: list[list[str | Text]] = [
        [
            opinion.renderer,
            "" if opinion.before is None else answer_text(opinion.before),
            "" if opinion.after is None else answer_text(opinion.after),
            "" if opinion.outcome is None else verdict(opinion.outcome),
            "" if opinion.share is None else f"{100 * opinion.share:.0f} %",
            opinion.failure or opinion.note,
        ]
        for opinion in opinions
    ]
    columns = ("renderer", "original", "attacked", "network", "of other seeds>", "note")
    return FittedTable(columns, rows, title="Second opinion: the scene drawn by other renderers")


def _survival(survival: HeldOver) -> FittedTable:
    low, high = survival.interval or (0.0, 1.0)
    share = "–" if survival.share is None else f"{100 * survival.share:.0f} % ({100 * low:.0f}–{100 * high:.0f})"
    row: list[str | Text] = [str(survival.variations), str(survival.right), str(survival.fooled), share]
    columns = ("cameras>", "right without the perturbation>", "fooled with it>", "survival (95 %)>")
    return FittedTable(columns, [row], title="Survival before cameras")


def _interpretation(interpretation: Interpretation) -> FittedTable:
    rows = [
        [
            fit.optimiser,
            f"{fit.rate:.0e}",
            f"{fit.losses[0] * 1000:.3f}",
            f"{min(fit.losses) * 1000:.3f}",
            answer_text(fit.after),
            "yes" if fit.after.label == interpretation.image.label else "no",
        ]
        for fit in interpretation.fits
    ]
    columns = ("optimiser", "rate>", *FIT_COLUMNS, "label after", "attacked label kept")
    answers = f"image: {answer_text(interpretation.image)}, scene: {answer_text(interpretation.scene)}"
    return FittedTable(columns, rows, title=f"Interpretation: fits of physical parameters to the image ({answers})")


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
    return FittedTable(columns, [row], title=f"Re-rendering defence: {found.optimiser}, rate {found.rate:g}")


def _adaptive(attack: AdaptiveAttack) -> FittedTable:
    row: list[str | Text] = [
        yes(attack.fooled),
        str(attack.steps),
        answer_text(attack.image),
        answer_text(attack.rerendered),
        f"{attack.goal_probability[0]:.3f} → {attack.goal_probability[-1]:.3f}",
        thousandths(attack.perceptibility),
    ]
    columns = (
        "defence fooled",
        "steps>",
        "attacked image",
        "re-rendered",
        "goal's label, re-rendered",
        "p saved ×1e-3>",
    )
    return FittedTable(columns, [row], title="Attack on pixels through the re-rendering defence")


def print_tasks(tasks: Mapping[str, object], folder: Path | None = None) -> None:
    """Prints what tasks add to a plan or to a result. folder: that of the job's files, if it is on this machine."""
    for part in tasks.values():
        if isinstance(part, Part):
            say(*part.tables(folder))
