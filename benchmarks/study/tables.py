"""The tables of the study: our rows beside the paper's, in the paper's layout."""

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from statistics import median_low
from typing import Any

from benchmarks.study.record import Record
from services.analysis.campaign_table import Cell, Rate, share_at

TITLES = {
    "alexnet-furniture": "AlexNet",
    "resnet34-furniture": "ResNet-34",
    "efficientnet-lite0": "EfficientNet-Lite0",
    "iep": "IEP",
}
"""Names of the networks on the pages, in their order there; the first two are the paper's architectures."""
CLASSIFICATION, VQA = "classification", "vqa"
"""The paper's tasks."""
NONE = "–"
BETWEEN = "\u00a0·\u00a0"
"""Stands between a rate and a p, which a line is not broken at."""
OF = "\u00a0of\u00a0"
QUERIES = (2, 5, 10, 30, 122)
SECONDS = (0.3, 1, 3, 10)
"""Budgets at which successes are stated; 122 queries are those of 120 steps."""


@cache
def paper() -> dict[str, Any]:
    """The figures that the paper states, with the place where it states them."""
    found: dict[str, Any] = json.loads(Path(__file__).with_name("paper.json").read_text("utf-8"))
    return found


def markdown(columns: Iterable[str], rows: Iterable[Iterable[str]], texts: int = 1) -> str:
    """A table; the first `texts` columns are of text, the others of numbers."""
    columns = list(columns)
    rule = [":---" if index < texts else "---:" for index in range(len(columns))]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (columns, rule, *rows))


def ordered(targets: Iterable[str]) -> list[str]:
    """Networks in the order of the pages; those that have no name there come last."""
    names = list(TITLES)
    return sorted(targets, key=lambda target: names.index(target) if target in TITLES else len(names))


def title(target: str) -> str:
    """The name of a network on the page."""
    return TITLES.get(target, target)


def differentiable(records: Sequence[Record], task: str = CLASSIFICATION) -> str:
    """The paper's table of a task: for each network its row, and ours by its count, verified, and in truncated pixels.

    Attacks called "<column>, <setting>" have rows of their own, for that setting, in their columns.
    """
    stated = paper()[task]["differentiable"]
    columns: list[str] = stated["columns"]
    rows: list[list[str]] = []
    for table in (record.table() for record in records):
        for target in ordered(table.targets):
            of_paper = _of_paper(stated, target)
            own = [of_paper[:1], _rows({name: table.cell(target, name) for name in columns}, "", columns), of_paper[1:]]
            settings: dict[str, dict[str, Cell | None]] = {}
            for attack in table.attacks:
                column, comma, setting = attack.partition(", ")
                if comma and (cell := table.cell(target, attack)) is not None:
                    settings.setdefault(setting, {})[column] = cell
            own += [_rows(cells, f"{setting}, ", columns) for setting, cells in settings.items()]
            block = [row for part in own for row in part]
            rows += [[f"**{title(target)}**" if number == 0 else "", *row] for number, row in enumerate(block)]
    return markdown(("network", "", "n", *columns), rows, texts=2)


def _of_paper(stated: Mapping[str, Any], target: str) -> list[list[str]]:
    """The paper's rows of a network: successes and p, and truncated pixels if it states them; none if it has none."""
    theirs = stated["targets"].get(target)
    if theirs is None:
        return []
    values = (f"{rate:.1f}{BETWEEN}{p:.1f}" for rate, p in zip(theirs["success"], theirs["p"], strict=True))
    rows = [["paper", str(stated["views"]), *values]]
    if any(value is not None for value in theirs["truncated"]):
        pixels = dict(zip(stated["columns"], theirs["truncated"], strict=True))
        rows.append(["truncated, paper", "", *(_number(pixels[name]) for name in stated["columns"])])
    return rows


def _rows(cells: Mapping[str, Cell | None], setting: str, columns: Sequence[str]) -> list[list[str]]:
    """Our rows of a network, of these cells by column."""
    own = [cells.get(name) for name in columns]
    return [
        [f"{setting}paper's count", _most(own), *(_both(cell, "loop_success") for cell in own)],
        [f"{setting}**verified**", _most(own), *(_bold(_both(cell, "success")) for cell in own)],
        [f"{setting}95\u00a0% interval", "", *(_interval(cell) for cell in own)],
        [f"{setting}truncated", "", *(_truncated(cell) for cell in own)],
    ]


def nondifferentiable(record: Record, task: str = CLASSIFICATION) -> str:
    """Successes of the attacks on the second renderer's image and parameters, beside the paper's counts."""
    stated, table = paper()[task]["nondifferentiable"], record.table()
    rows: list[list[str]] = []
    for target in ordered(table.targets):
        if (theirs := stated["targets"].get(target)) is not None:
            for number, (name, steps, count) in enumerate(theirs["attacks"]):
                asked = f"paper: {name}, {steps:,} steps"
                counts = _counts(Rate.of_cases(count, stated["views"]))
                rows.append([f"**{title(target)}**" if number == 0 else "", asked, *counts, "", "", "", ""])
        for attack in table.attacks:
            if (cell := table.cell(target, attack)) is not None:
                loop = f"{cell.loop_success.count}{OF}{cell.loop_success.of}"
                jobs = [job for job in record.jobs if (job.target, job.attack) == (target, attack)]
                queries = [job.queries for job in jobs if job.queries is not None]
                lowered = [job.lowered for job in jobs if job.lowered is not None]
                rows.append(
                    [
                        "",
                        f"here: {attack}",
                        *map(_bold, _counts(cell.success)),
                        loop,
                        milli(cell.perceptibility),
                        _number(median_low(queries) if queries else None, 0),
                        f"{sum(lowered)}{OF}{len(lowered)}" if lowered else NONE,
                    ]
                )
    counts = ("verified", "%", "95 % interval", "in the loop")
    columns = ("network", "attack", *counts, "p ×10⁻³", "queries, median", "objective lowered")
    return markdown(columns, rows, texts=2)


def work(records: Sequence[Record]) -> str:
    """Per cent of all cases that were fooled within so many queries, and within so many seconds."""
    rows = []
    for table in (record.table() for record in records):
        for target in ordered(table.targets):
            cells = [cell for cell in table.cells if cell.target == target and cell.success.of]
            for number, cell in enumerate(cells):
                shares = [share_at(cell.by_queries, cell.success.of, budget) for budget in QUERIES]
                shares += [share_at(cell.by_seconds, cell.success.of, budget) for budget in SECONDS]
                name = f"**{title(target)}**" if number == 0 else ""
                rows.append([name, cell.attack, str(cell.success.of), *(f"{100 * share:.0f}" for share in shares)])
    heads = [f"{QUERIES[0]} queries", *map(str, QUERIES[1:]), f"{SECONDS[0]} s", *(f"{one:g} s" for one in SECONDS[1:])]
    return markdown(("network", "attack", "n", *heads), rows, texts=2)


def views(records: Sequence[Record], of: str = "models") -> str:
    """How many views were asked for, right, and attacked, and of how many models or scenes."""
    rows = [
        [
            title(one.target),
            one.renderer,
            f"{one.size[0]}²" if one.size[0] == one.size[1] else f"{one.size[0]}×{one.size[1]}",
            str(one.asked),
            f"{one.right} ({100 * one.right / one.asked:.0f} %)",
            str(one.chosen),
            str(one.meshes),
            NONE if one.least_confidence is None else f"{100 * one.least_confidence:.0f} %",
        ]
        for record in records
        for one in record.views
    ]
    columns = ("network", "renderer", "size", "views asked for", "right", "attacked", of, "least confident")
    return markdown(columns, rows, texts=2)


def orders(record: Record, target: str) -> str:
    """The columns of a network from the highest to the lowest rate of success, and from the lowest to the highest p.

    Attacks in another setting than the column's own are left out.
    """
    cells = [cell for cell in record.table().cells if cell.target == target and ", " not in cell.attack]
    by_success = sorted(cells, key=lambda cell: -(cell.success.rate or 0.0))
    by_p = sorted((c for c in cells if c.perceptibility is not None), key=lambda cell: cell.perceptibility or 0.0)
    success = _in_order([(cell.attack, _percent(cell.success.rate)) for cell in by_success], ">")
    p = _in_order([(cell.attack, milli(cell.perceptibility)) for cell in by_p], "<")
    return f"{title(target)}: {success} (per cent, verified); p {p} (×10⁻³)."


def _in_order(named: Sequence[tuple[str, str]], sign: str) -> str:
    """Names with their values and the sign between them; "=" where the values are written alike."""
    text = ""
    for place, (name, value) in enumerate(named):
        between = "" if place == 0 else " = " if value == named[place - 1][1] else f" {sign} "
        text += f"{between}{name} {value}"
    return text


def _most(cells: Sequence[Cell | None]) -> str:
    """The number of cases of these cells, as a range where it differs."""
    of = sorted({cell.success.of for cell in cells if cell is not None})
    return "" if not of else str(of[0]) if len(of) == 1 else f"{of[0]}–{of[-1]}"


def _both(cell: Cell | None, which: str) -> str:
    if cell is None:
        return ""
    rate: Rate = getattr(cell, which)
    p = cell.perceptibility if which == "success" else cell.loop_perceptibility
    return f"{_percent(rate.rate)}{BETWEEN}{milli(p)}"


def _interval(cell: Cell | None) -> str:
    if cell is None or cell.success.low is None or cell.success.high is None:
        return ""
    return f"{100 * cell.success.low:.1f}–{100 * cell.success.high:.1f}"


def _counts(rate: Rate) -> tuple[str, str, str]:
    if rate.low is None or rate.high is None:
        return f"0{OF}0", NONE, NONE
    return f"{rate.count}{OF}{rate.of}", _percent(rate.rate), f"{100 * rate.low:.1f}–{100 * rate.high:.1f}"


def _truncated(cell: Cell | None) -> str:
    return "" if cell is None else _number(cell.truncated)


def _bold(text: str) -> str:
    return f"**{text}**" if text and text != NONE else text


def _number(value: float | None, digits: int = 1) -> str:
    return NONE if value is None else f"{value:,.{digits}f}"


def _percent(rate: float | None) -> str:
    return NONE if rate is None else f"{100 * rate:.1f}"


def milli(value: float | None) -> str:
    """A p in thousandths, as in all tables."""
    return NONE if value is None else f"{1000 * value:.1f}"
