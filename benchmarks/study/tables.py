"""The tables of the study: our rows beside the paper's, in the paper's layout; why attacks on the scene succeed or
fail; and what was asked, by family and by kind of answer, with the modules that were fooled first.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any, get_args

from benchmarks.study.record import Asked, Job, Record
from scene_attack.analysis.campaign_table import Cell, Rate, share_at
from scene_attack_accuracy import tables
from scene_attack_questions.executor import KINDS, kind_of
from scene_attack_questions.families import Kind

TITLES = {
    "alexnet-furniture": "AlexNet",
    "resnet34-furniture": "ResNet-34",
    "efficientnet-lite0": "EfficientNet-Lite0",
    "iep": "IEP",
    "alexnet-one-look": "AlexNet, one look",
    "resnet34-one-look": "ResNet-34, one look",
}
"""Names of the networks on the pages, in their order there; the first two are the paper's architectures."""
CLASSIFICATION, VQA = "classification", "vqa"
"""The paper's tasks."""
NONE = "–"
BETWEEN = "\u00a0·\u00a0"
"""Stands between a rate and a p, which a line is not broken at."""
SETTING = ", "
"""Stands between an attack and its setting in the name of a column: "combined, 448²", "bump, 0.2"."""
OF = "\u00a0of\u00a0"
QUERIES = (2, 5, 10, 30, 122)
"""Budgets at which successes are stated; 122 queries are those of 120 steps."""


@cache
def paper() -> dict[str, Any]:
    """The figures that the paper states, with the place where it states them."""
    figures: dict[str, Any] = json.loads(Path(__file__).with_name("paper.json").read_text("utf-8"))
    return figures


def markdown(columns: Iterable[str], rows: Iterable[Iterable[str]], texts: int = 1) -> str:
    """A table; the first `texts` columns are of text, the others of numbers."""
    return tables.markdown([name if number < texts else f"{name}>" for number, name in enumerate(columns)], rows)


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
                column, comma, setting = attack.partition(SETTING)
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
        rows.append(["truncated, paper", "", *(decimal(pixels[name]) for name in stated["columns"])])
    return rows


def _rows(cells: Mapping[str, Cell | None], setting: str, columns: Sequence[str]) -> list[list[str]]:
    """Our rows of a network, of these cells by column."""
    own = [cells.get(name) for name in columns]
    return [
        [f"{setting}paper's count", _most(own), *(both(cell, "loop_success") for cell in own)],
        [f"{setting}**verified**", _most(own), *(bold(both(cell, "success")) for cell in own)],
        [f"{setting}95\u00a0% interval", "", *(interval(cell) for cell in own)],
        [f"{setting}truncated", "", *(truncated(cell) for cell in own)],
    ]


def nondifferentiable(record: Record, task: str = CLASSIFICATION) -> str:
    """Successes of the attacks on the second renderer's image and parameters, beside the paper's counts."""
    stated, table = paper()[task]["nondifferentiable"], record.table()
    rows: list[list[str]] = []
    for target in ordered(table.targets):
        if (theirs := stated["targets"].get(target)) is not None:
            for number, (name, steps, count) in enumerate(theirs["attacks"]):
                asked = f"paper: {name}, {steps:,} steps"
                counts = rate_texts(Rate.of_cases(count, stated["views"]))
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
                        *map(bold, rate_texts(cell.success)),
                        loop,
                        milli(cell.perceptibility),
                        decimal(median(queries) if queries else None, 0),
                        f"{sum(lowered)}{OF}{len(lowered)}" if lowered else NONE,
                    ]
                )
    counts = ("verified", "%", "95 % interval", "in the loop")
    columns = ("network", "attack", *counts, "p ×10⁻³", "queries, median", "objective lowered")
    return markdown(columns, rows, texts=2)


def work(records: Sequence[Record]) -> str:
    """Per cent of all cases that were fooled within each budget of queries."""
    rows = []
    for table in (record.table() for record in records):
        for target in ordered(table.targets):
            cells = [cell for cell in table.cells if cell.target == target and cell.success.of]
            for number, cell in enumerate(cells):
                shares = [share_at(cell.by_queries, cell.success.of, budget) for budget in QUERIES]
                name = f"**{title(target)}**" if number == 0 else ""
                rows.append([name, cell.attack, str(cell.success.of), *(f"{100 * share:.0f}" for share in shares)])
    heads = [f"{QUERIES[0]} queries", *map(str, QUERIES[1:])]
    return markdown(("network", "attack", "n", *heads), rows, texts=2)


def views(records: Sequence[Record], of: str = "models") -> str:
    """Numbers of views that were requested, right and attacked, and of their models or scenes."""
    rows = [
        [
            title(row.target),
            row.renderer,
            f"{row.size[0]}²" if row.size[0] == row.size[1] else f"{row.size[0]}×{row.size[1]}",
            str(row.asked),
            f"{row.right} ({100 * row.right / row.asked:.0f} %)",
            str(row.chosen),
            str(row.meshes),
            NONE if row.least_confidence is None else f"{100 * row.least_confidence:.0f} %",
        ]
        for record in records
        for row in record.views
    ]
    columns = ("network", "renderer", "size", "views asked for", "right", "attacked", of, "least confident")
    return markdown(columns, rows, texts=2)


def orders(records: Sequence[Record]) -> str:
    """The columns of each network from the highest to the lowest rate of success, and from the lowest to the highest p.

    Attacks in another setting than the column's own are left out.
    """
    lines = []
    for table in (record.table() for record in records):
        for target in table.targets:
            cells = [cell for cell in table.cells if cell.target == target and SETTING not in cell.attack]
            by_success = sorted(cells, key=lambda cell: -(cell.success.rate or 0.0))
            by_p = sorted(
                (c for c in cells if c.perceptibility is not None), key=lambda cell: cell.perceptibility or 0.0
            )
            success = _in_order([(cell.attack, _percent(cell.success.rate)) for cell in by_success], ">")
            p = _in_order([(cell.attack, milli(cell.perceptibility)) for cell in by_p], "<")
            lines.append(f"- {title(target)}: {success} (per cent, verified); p {p} (×10⁻³).")
    return "\n".join(lines)


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


def both(cell: Cell | None, which: str) -> str:
    """Per cent and mean p of a cell: of its "success", verified, or "loop_success", the paper's; "" without a cell."""
    if cell is None:
        return ""
    rate: Rate = getattr(cell, which)
    p = cell.perceptibility if which == "success" else cell.loop_perceptibility
    return f"{_percent(rate.rate)}{BETWEEN}{milli(p)}"


def interval(cell: Cell | None) -> str:
    """The interval of a cell's verified rate, per cent; "" without one."""
    if cell is None or cell.success.low is None or cell.success.high is None:
        return ""
    return f"{100 * cell.success.low:.1f}–{100 * cell.success.high:.1f}"


def rate_texts(rate: Rate) -> tuple[str, str, str]:
    """A rate as a count of cases, per cent, and its interval."""
    if rate.low is None or rate.high is None:
        return f"0{OF}0", NONE, NONE
    return f"{rate.count}{OF}{rate.of}", _percent(rate.rate), f"{100 * rate.low:.1f}–{100 * rate.high:.1f}"


def truncated(cell: Cell | None) -> str:
    """Pixels beyond U in some step, as a mean over all cases; "" without a cell."""
    return "" if cell is None else decimal(cell.truncated)


def bold(text: str) -> str:
    """A text in bold, unless there is none."""
    return f"**{text}**" if text and text != NONE else text


def decimal(value: float | None, digits: int = 1) -> str:
    """A number with so many digits after the point."""
    return NONE if value is None else f"{value:,.{digits}f}"


def _percent(rate: float | None) -> str:
    return NONE if rate is None else f"{100 * rate:.1f}"


def milli(value: float | None) -> str:
    """A p in thousandths, as in all tables."""
    return NONE if value is None else f"{1000 * value:.1f}"


GROUPS = {
    "scene": "scene",
    "filter": "filter",
    "unique": "unique",
    "relate": "relate",
    "same": "same",
    "union": "or",
    "intersect": "and",
    "count": "count",
    "exist": "exist",
    "query": "query",
    "equal_integer": "compare integers",
    "less": "compare integers",
    "greater": "compare integers",
    "equal": "compare attributes",
}
"""Names of the groups of functions, in the order of a program, by how the functions' names begin."""


def group(function: str) -> str:
    """Returns the group of a function, such as "filter" of "filter_color"."""
    return GROUPS.get(function) or GROUPS[function.partition("_")[0]]


LONGEST = (6, 12)
"""Lengths of programs, in functions, that end a row."""
SHOWN = 6
"""Answers of another kind that are listed."""


def alone(record: Record) -> list[Job]:
    """Returns the jobs with one question, which the network had right."""
    return [job for job in record.jobs if job.right and len(job.questions) == 1]


def attacks(record: Record) -> list[str]:
    """Returns the attacks of these jobs, in the order of the campaign."""
    return list(dict.fromkeys(job.attack for job in alone(record)))


def by_question(record: Record) -> str:
    """Success by kind of family, by kind of the answer, and by length of the program: a row for each that was asked."""
    rows = []
    for heading, of, values in (
        ("family", lambda question: question.family, get_args(Kind)),
        ("answer", lambda question: question.kind, tuple(KINDS)),
        (
            "functions",
            lambda question: _length(len(question.functions)),
            tuple(map(_length, (*LONGEST, LONGEST[-1] + 1))),
        ),
    ):
        block = [_asked_row(record, value, of) for value in values]
        block = [cells for cells in block if any(cell != NONE for cell in cells[1:])]
        rows += [[f"**{heading}**" if number == 0 else "", *cells] for number, cells in enumerate(block)]
    return markdown(("", "", *attacks(record)), rows, texts=2)


def left_kind(record: Record) -> str:
    """Numbers of wrong answers after an attack that are of another kind than the question's, and some of them."""
    rows, lines = [], []
    for attack in attacks(record):
        fooled = [job.questions[0] for job in alone(record) if job.attack == attack and job.success]
        left = [question for question in fooled if question.of_kind is False]
        to = Counter(kind_of(question.after) for question in left if question.after is not None)
        rows.append(
            [attack, str(len(fooled)), str(len(left)), ", ".join(f"{kind} {n}" for kind, n in to.most_common()) or NONE]
        )
        lines += [f"- {attack}: “{question.text}” {question.right}, then **{question.after}**" for question in left]
    table = markdown(("attack", "fooled", "of another kind", "which"), rows)
    return "\n\n".join([table, "\n".join(lines[:SHOWN])]) if lines else table


def fooled_first(record: Record) -> str:
    """Fooled questions whose program has a group of functions, and those in which one of the group was fooled first."""
    rows = []
    columns = {
        attack: [job.questions[0] for job in alone(record) if job.attack == attack and job.success]
        for attack in attacks(record)
    }
    for name in dict.fromkeys(GROUPS.values()):
        cells = [_first(name, fooled) for fooled in columns.values()]
        if any(cell != NONE for cell in cells):
            rows.append([name, *cells])
    return markdown(("module", *columns), rows)


def _first(name: str, fooled: Sequence[Asked]) -> str:
    having = [question for question in fooled if name in map(group, question.functions)]
    first = [
        question
        for question in having
        if question.first is not None and group(question.functions[question.first]) == name
    ]
    return f"{len(first)}{OF}{len(having)}" if having else NONE


def _asked_row(record: Record, value: str, of: Callable[[Asked], str]) -> list[str]:
    cells = []
    for attack in attacks(record):
        own = [job for job in alone(record) if job.attack == attack and of(job.questions[0]) == value]
        cells.append(f"{sum(job.success for job in own)}{OF}{len(own)}" if own else NONE)
    return [value.replace("_", " "), *cells]


def _length(functions: int) -> str:
    low = 1
    for high in LONGEST:
        if functions <= high:
            return f"{low}–{high}"
        low = high + 1
    return f"{low} and more"


COLUMNS = ("normals", "combined")
"""The columns of the first table by which the paper fools most views, of those that attack the scene."""
RANGES = ((0.0, 0.10), (0.10, 0.15), (0.15, 0.20), (0.20, 1.01))
"""Ranges of covered shares, each without its upper edge."""
ENOUGH = RANGES[0][1]
"""A share of the image from which on the successes are stated once more."""


def by_coverage(records: Sequence[Record]) -> str:
    """For each network and each range of covered shares: views, successes, and how far the others were pushed."""
    rows, sums = [], []
    for record in records:
        for target in record.table().targets:
            jobs = [job for job in record.jobs if job.target == target and job.attack in COLUMNS and job.share]
            ranges = {(low, high): [job for job in jobs if low <= (job.share or 0.0) < high] for low, high in RANGES}
            covered = [[share_range(low, high), *_covered_row(own)] for (low, high), own in ranges.items() if own]
            rows += [[f"**{title(target)}**" if number == 0 else "", *row] for number, row in enumerate(covered)]
            broad = [job for job in jobs if (job.share or 0.0) >= ENOUGH]
            if broad:
                sums.append(f"{title(target)} {' and '.join(f'{_rate(broad, name)} by {name}' for name in COLUMNS)}")
    if not rows:
        return NONE
    heads = ("network", "covered", "held", "views", *COLUMNS, "truncated")
    summary = f"Of the views with at least {100 * ENOUGH:.0f} % covered are fooled: {'; '.join(sums)}."
    return f"{markdown(heads, rows, texts=3)}\n\n{summary}"


def by_confidence(records: Sequence[Record]) -> str:
    """For each network and attack: the confidence before the attack and p, of the fooled and of the held views."""
    rows = []
    for record in records:
        table = record.table()
        for target in table.targets:
            for number, attack in enumerate(table.attacks):
                jobs = [job for job in record.jobs if (job.target, job.attack) == (target, attack) and job.right]
                fooled, held = ([job for job in jobs if job.success is which] for which in (True, False))
                cells = [cell for own in (fooled, held) for cell in (str(len(own)), _sure(own), _far(own))]
                rows.append([f"**{title(target)}**" if number == 0 else "", attack, *cells])
    heads = ("network", "attack", "fooled", "confidence", "p", "held", "confidence", "p")
    return markdown(heads, rows, texts=2)


def share_range(low: float, high: float) -> str:
    """A range of shares in words."""
    if low == 0.0:
        return f"below {100 * high:.0f} %"
    return f"{100 * low:.0f}–{100 * high:.0f} %" if high <= 1 else f"{100 * low:.0f} % and more"


def _covered_row(jobs: Sequence[Job]) -> list[str]:
    held = [job for job in jobs if not job.success]
    names = sorted({job.mesh.rpartition("/")[2] for job in held})
    counts = [fooled_of([job for job in jobs if job.attack == name]) for name in COLUMNS]
    return [", ".join(names) or NONE, str(len({job.scene for job in jobs})), *counts, _pushed(held)]


def fooled_of(jobs: Sequence[Job]) -> str:
    """How many of these jobs are successes."""
    return f"{sum(job.success for job in jobs)}{OF}{len(jobs)}" if jobs else NONE


def _rate(jobs: Sequence[Job], attack: str) -> str:
    own = [job for job in jobs if job.attack == attack]
    return f"{100 * sum(job.success for job in own) / len(own):.1f} %" if own else NONE


def _pushed(held: Sequence[Job]) -> str:
    """Median share of covered pixels with a value beyond U in some step, over the views that held."""
    return _middle((job.truncated or 0) / (job.covered or 1) for job in held)


def _sure(jobs: Sequence[Job]) -> str:
    return _middle(job.before_confidence for job in jobs)


def _far(jobs: Sequence[Job]) -> str:
    values = [job.p for job in jobs if job.p is not None]
    return milli(median(values) if values else None)


def _middle(shares: Iterable[float]) -> str:
    values = list(shares)
    return f"{100 * median(values):.0f}\u00a0%" if values else NONE
