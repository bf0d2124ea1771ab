"""A campaign as CSV, its table and its cases, and as the paper's table in LaTeX."""

import csv
import io
from collections.abc import Iterator, Sequence

from services.analysis.campaign_table import CASE_FIELDS, CaseRow, Cell, Rate, Table

COUNTS = ("jobs", "ended", "failed", "cancelled", "reused", "held_within_epsilon")
RATES = ("success", "loop_success")
OUTCOMES = ("fooled", "changed", "became-right", "still-wrong", "held")
_OF_CASE = (
    "state",
    "right",
    "outcome",
    "epsilon_bound",
    "success",
    "loop_success",
    "perceptibility",
    "loop_perceptibility",
    "truncated",
)
_WORK = ("queries", "seconds", "run_seconds", "reused")
_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{c: rf"\{c}" for c in "&%$#_{}"},
}


def to_csv(table: Table) -> str:
    """One line for each target and attack; rates and their intervals in [0,1], p in full range; empty where unknown."""
    out = io.StringIO()
    rates = [f"{name}{part}" for name in RATES for part in ("_count", "_of", "_rate", "_low", "_high")]
    lines = csv.writer(out, lineterminator="\n")
    means = ("perceptibility", "loop_perceptibility", "truncated")
    lines.writerow(["campaign", "target", "attack", *COUNTS, *OUTCOMES, *rates, *means])
    for cell in table.cells:
        lines.writerow([plain(value) for value in _values(table, cell)])
    return out.getvalue()


def _values(table: Table, cell: Cell) -> Iterator[object]:
    yield from (table.campaign, cell.target, cell.attack)
    yield from (getattr(cell, name) for name in COUNTS)
    yield from (cell.outcomes.get(name, 0) for name in OUTCOMES)
    for name in RATES:
        rate: Rate = getattr(cell, name)
        yield from (rate.count, rate.of, rate.rate, rate.low, rate.high)
    yield from (cell.perceptibility, cell.loop_perceptibility, cell.truncated)


def plain(value: object) -> object:
    """The value; a text that a spreadsheet would take for a formula is preceded by an apostrophe."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value


def cases_to_csv(cases: Sequence[CaseRow]) -> str:
    """One line for each job that has ended; p in full range, empty where unknown."""
    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(["number", "job", *(name.replace(" ", "_") for name in CASE_FIELDS), *_OF_CASE, *_WORK])
    for one in cases:
        values = [getattr(one.case, name) for name in (*_OF_CASE, *_WORK)]
        lines.writerow(
            [plain(value) for value in (one.number, one.job, *(one.fields[name] for name in CASE_FIELDS), *values)]
        )
    return out.getvalue()


def to_latex(table: Table) -> str:
    """The paper's table with booktabs: for each target successes with intervals, the paper's count, p and pixels."""
    count = len(table.attacks)
    head = " & ".join(rf"\multicolumn{{2}}{{c}}{{{tex(name)}}}" for name in table.attacks)
    rules = " ".join(rf"\cmidrule(lr){{{2 * i + 2}-{2 * i + 3}}}" for i in range(count))
    lines = [
        "% needs \\usepackage{booktabs}",
        rf"\begin{{tabular}}{{l{'rr' * count}}}",
        r"\toprule",
        rf"& {head} \\",
        rules,
        " & ".join(["", *["Succ.", "$p$"] * count]).lstrip() + r" \\",
        r"\midrule",
    ]
    for target in table.targets:
        cells = [table.cell(target, attack) for attack in table.attacks]
        lines.append(" & ".join([tex(target), *(part for cell in cells for part in _verified(cell))]) + r" \\")
        lines.append(" & ".join([r"\quad 95\,\% interval, $n$", *(p for c in cells for p in _interval(c))]) + r" \\")
        lines.append(" & ".join([r"\quad in the loop", *(part for cell in cells for part in _in_loop(cell))]) + r" \\")
        lines.append(" & ".join([r"\quad truncated pixels", *(p for c in cells for p in _truncated(c))]) + r" \\")
    lines += [
        r"\bottomrule",
        r"\end{tabular}",
        r"% Succ.: right before, fooled and verified on the exact image, in per cent; p: mean over these, times 1000.",
        r"% in the loop: fooled by the truncated image, as the paper counts, and the mean p of its float images.",
    ]
    return "\n".join(lines) + "\n"


def _verified(cell: Cell | None) -> tuple[str, str]:
    return ("--", "--") if cell is None else (_percent(cell.success.rate), _milli(cell.perceptibility))


def _interval(cell: Cell | None) -> tuple[str, str]:
    if cell is None or cell.success.rate is None:
        return "--", "--"
    return f"[{_percent(cell.success.low)}, {_percent(cell.success.high)}]", str(cell.success.of)


def _in_loop(cell: Cell | None) -> tuple[str, str]:
    return ("--", "--") if cell is None else (_percent(cell.loop_success.rate), _milli(cell.loop_perceptibility))


def _truncated(cell: Cell | None) -> tuple[str, str]:
    return ("--" if cell is None or cell.truncated is None else f"{cell.truncated:.1f}"), ""


def _percent(rate: float | None) -> str:
    return "--" if rate is None else f"{100 * rate:.1f}"


def _milli(value: float | None) -> str:
    return "--" if value is None else f"{1000 * value:.1f}"


def tex(text: str) -> str:
    """The text with LaTeX's special characters escaped."""
    return "".join(_TEX.get(character, character) for character in text)
