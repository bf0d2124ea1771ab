"""A campaign in figures: the paper's table, mean curves, the time left, and its cases by any two of their fields.

Every figure of the table is over all cases of a cell, none of them left out for having failed to fool the network. A
case counts if the network's first answer was right; a job that failed counts as no success.

The end of the file writes a campaign as text: its table and its cases as CSV, and the paper's table in LaTeX.
"""

import csv
import io
import operator
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from statistics import stdev
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.analysis.verdict import NORMAL_95, SUCCESS, Verdict, wilson
from scene_attack.strict import absent


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Case(_Record):
    """One job of a campaign after it has ended."""

    target: str
    attack: str = Field(description="name of the attack in the campaign")
    state: str = Field(description='"succeeded" (ran to its end), "failed" or "cancelled"')
    right: bool = Field(description="whether the truth is known and the network's first answer was right")
    outcome: str | None = Field(None, description="the job's outcome; null if it did not run to its end")
    epsilon_bound: bool = Field(False, description="some values of the stored perturbation are at their ε")
    success: bool = Field(False, description="outcome `fooled`, and verified")
    loop_success: bool = Field(
        False, description="right before, and fooled by the truncated image in the loop: the paper's count"
    )
    perceptibility: float | None = Field(
        None, description="p of the exact image, before it is rounded to 8 bits where that is known: the paper's p"
    )
    loop_perceptibility: float | None = Field(
        None, description="p of the truncated float image in the loop, at the stored step"
    )
    truncated: int | None = Field(None, description="pixels that were truncated in at least one step")
    survival: float | None = Field(
        None,
        exclude_if=absent,
        description="share of cameras before which the verified adversary fools; null if that was not asked for",
    )
    second_opinion: dict[str, Verdict] = Field(
        {},
        exclude_if=operator.not_,
        description="what the stored perturbation came to when other renderers drew it, by renderer",
    )
    queries: int | None = None
    seconds: float | None = Field(None, description="run time of the attack")
    run_seconds: float | None = Field(None, description="run time of the whole job")
    reused: bool = Field(False, description="an earlier result of the same request on the same backend was taken")


class Rate(_Record):
    """A share of cases, with Wilson's 95 % interval; null where there is no case."""

    count: int
    of: int
    rate: float | None
    low: float | None
    high: float | None

    @classmethod
    def of_cases(cls, count: int, of: int) -> "Rate":
        """The rate `count / of`."""
        if of == 0:
            return cls(count=0, of=0, rate=None, low=None, high=None)
        low, high = wilson(count, of)
        return cls(count=count, of=of, rate=count / of, low=low, high=high)


class Mean(_Record):
    """The mean of shares of several cases, with a 95 % interval: Wilson's, as if each share were all or nothing. That
    is the widest that shares of this mean can have, and not empty where all are equal.
    """

    mean: float
    low: float
    high: float
    of: int = Field(description="cases")

    @classmethod
    def of_shares(cls, values: Sequence[float]) -> "Mean | None":
        """The mean of shares in [0,1]; None of none."""
        if not values:
            return None
        low, high = wilson(sum(values), len(values))
        return cls(mean=sum(values) / len(values), low=low, high=high, of=len(values))


Corners = list[tuple[float, int]]
"""Corners of a step curve: the work done, and the number of successes by then."""


class Cell(_Record):
    """All jobs of one attack on one target."""

    target: str
    attack: str
    jobs: int = Field(description="jobs of the cell, ended or not")
    ended: int
    failed: int
    cancelled: int = Field(description="cancelled jobs, which count nowhere")
    reused: int
    outcomes: dict[str, int]
    held_within_epsilon: int = Field(
        0, description="of those that held: ε bound the search, and nothing was tried beyond"
    )
    success: Rate = Field(description="right before, fooled and verified")
    loop_success: Rate = Field(description="right before and fooled by the truncated image in the loop: the paper's")
    perceptibility: float | None = Field(
        description="mean p of the exact images of the successes, before they are rounded to 8 bits"
    )
    loop_perceptibility: float | None = Field(
        description="mean p of the truncated float images in the loop of those that the paper counts"
    )
    truncated: float | None = Field(description="mean number of pixels truncated in at least one step, over all cases")
    survival: Mean | None = Field(
        None,
        exclude_if=absent,
        description="mean share of cameras before which the verified adversaries fool; null if none was asked for",
    )
    second_opinion: dict[str, Rate] = Field(
        {},
        exclude_if=operator.not_,
        description="by renderer the verified adversaries that still fool when it draws them, of those whose scene "
        "before the network has right there too",
    )
    by_queries: Corners = Field(description="successes against queries, among `success.of` cases")
    by_seconds: Corners = Field(description="successes against seconds, among `success.of` cases")
    by_p: Corners = Field([], description="successes against p of the exact image, among `success.of` cases")
    most_queries: float | None = Field(None, description="most queries of any case: as far as `by_queries` is known")
    most_seconds: float | None = Field(None, description="most seconds of any case: as far as `by_seconds` is known")


class Table(_Record):
    """The table of a campaign: a row for each target, a column for each attack."""

    campaign: str
    targets: list[str]
    attacks: list[str]
    cells: list[Cell]

    @property
    def renderers(self) -> list[str]:
        """The renderers that were asked for a second opinion."""
        return list(dict.fromkeys(name for cell in self.cells for name in cell.second_opinion))

    def cell(self, target: str, attack: str) -> Cell | None:
        """The cell of a target and an attack; None if the campaign does not combine them."""
        return next((cell for cell in self.cells if (cell.target, cell.attack) == (target, attack)), None)


def table(campaign: str, planned: Sequence[tuple[str, str]], cases: Sequence[Case]) -> Table:
    """The table of the jobs that have ended, `cases`, among the `planned` ones, (target, attack) of every job.

    Rows and columns are in the order in which they first occur.
    """
    count = Counter(planned)
    return Table(
        campaign=campaign,
        targets=list(dict.fromkeys(target for target, _ in planned)),
        attacks=list(dict.fromkeys(attack for _, attack in planned)),
        cells=[
            _cell(target, attack, jobs, [case for case in cases if (case.target, case.attack) == (target, attack)])
            for (target, attack), jobs in count.items()
        ],
    )


def _cell(target: str, attack: str, jobs: int, own: Sequence[Case]) -> Cell:
    counted = [case for case in own if case.right and case.state != "cancelled"]
    won = [case for case in counted if case.success]
    in_loop = [case for case in counted if case.loop_success]
    return Cell(
        target=target,
        attack=attack,
        jobs=jobs,
        ended=len(own),
        failed=sum(case.state == "failed" for case in own),
        cancelled=sum(case.state == "cancelled" for case in own),
        reused=sum(case.reused for case in own),
        outcomes=dict(sorted(Counter(case.outcome for case in own if case.outcome is not None).items())),
        held_within_epsilon=sum(case.outcome == "held" and case.epsilon_bound for case in own),
        success=Rate.of_cases(len(won), len(counted)),
        loop_success=Rate.of_cases(len(in_loop), len(counted)),
        perceptibility=mean([case.perceptibility for case in won]),
        loop_perceptibility=mean([case.loop_perceptibility for case in in_loop]),
        truncated=mean([case.truncated for case in counted]),
        survival=Mean.of_shares([case.survival for case in won if case.survival is not None]),
        second_opinion={
            name: Rate.of_cases(words.count(SUCCESS), words.count(SUCCESS) + words.count("held"))
            for name, words in _opinions(won).items()
        },
        by_queries=corners([case.queries for case in won]),
        by_seconds=corners([case.seconds for case in won]),
        by_p=corners([case.perceptibility for case in won]),
        most_queries=max((case.queries for case in counted if case.queries is not None), default=None),
        most_seconds=max((case.seconds for case in counted if case.seconds is not None), default=None),
    )


def _opinions(cases: Sequence[Case]) -> dict[str, list[Verdict]]:
    """What the cases came to, by each renderer that was asked."""
    words: dict[str, list[Verdict]] = defaultdict(list)
    for case in cases:
        for name, word in case.second_opinion.items():
            words[name].append(word)
    return dict(sorted(words.items()))


def mean(values: Sequence[float | None]) -> float | None:
    """The mean of the values that are there; None if there is none."""
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None


def corners(work: Sequence[float | None]) -> Corners:
    """The corners of the number of successes against the work after which each came. Equal work makes one corner."""
    latest: dict[float, int] = {}
    for number, at in enumerate(sorted(amount for amount in work if amount is not None), 1):
        latest[float(at)] = number
    return list(latest.items())


def share_at(curve: Corners, of: int, work: float) -> float:
    """The share of `of` cases that succeeded with at most this much work: the height of the step curve there."""
    return max((count for at, count in curve if at <= work), default=0) / of


CURVES = ("loss", "advantage", "distance")


class Curves(BaseModel):
    """One attack's curves: a value for each step, from the trace."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    loss: list[float] = Field(description="probability of the label to leave, or 1 minus that of the label to reach")
    advantage: list[float] = Field(description="log-probability advantage of the right answer; below 0: fooled")
    distance: list[float] = Field(description="‖ΔY‖₂ of the image, RGB in [0,1]")


class MeanCurves(Curves):
    """The mean curves of all cases of a cell. A case that has ended keeps its last value, so all are in every mean."""

    target: str
    attack: str
    cases: int


def mean_curve(curves: Sequence[Sequence[float]]) -> list[float]:
    """The mean at each step over all curves; one that has ended keeps its last value. Curves without values count not.

    The result has as many values as the longest curve.
    """
    there = [curve for curve in curves if curve]
    longest = max(map(len, there), default=0)
    return [sum(curve[min(step, len(curve) - 1)] for curve in there) / len(there) for step in range(longest)]


def mean_curves(traced: Iterable[tuple[str, str, Curves]]) -> list[MeanCurves]:
    """The mean curves of each target and attack, from (target, attack, curves) of each case, in order of occurrence."""
    cells: dict[tuple[str, str], list[Curves]] = {}
    for target, attack, curves in traced:
        cells.setdefault((target, attack), []).append(curves)
    return [
        MeanCurves(
            target=target,
            attack=attack,
            cases=len(own),
            **{measure: mean_curve([getattr(curve, measure) for curve in own]) for measure in CURVES},
        )
        for (target, attack), own in cells.items()
    ]


def time_left(planned: Sequence[tuple[str, str]], cases: Sequence[Case], workers: int = 1) -> float | None:
    """Seconds until all `planned` jobs, (target, attack) of each, have ended, with so many workers at once.

    A job takes the mean time of the ended ones of its target and attack, else of its attack, else of all; reused
    results are left out of the means, and every job left is taken for one that has to run. None before a job has ended.
    """
    timed = [(case.target, case.attack, case.run_seconds) for case in cases if not case.reused]
    known = [(target, attack, seconds) for target, attack, seconds in timed if seconds is not None]
    remaining = Counter(planned)
    remaining.subtract((case.target, case.attack) for case in cases)
    if not known:
        return None if any(remaining.values()) else 0.0
    left = 0.0
    for (target, attack), count in remaining.items():
        own = [s for t, a, s in known if (t, a) == (target, attack)]
        like = [s for _, a, s in known if a == attack]
        times = own or like or [s for *_, s in known]
        left += count * sum(times) / len(times)
    return left / max(1, workers)


CASE_FIELDS = ("scene", "azimuth", "truth", "first answer", "target", "attack", "seed")
"""Fields of a case that the rows or the columns of a grid may stand for."""
GRID_MEASURES = ("success", "perceptibility", "queries", "seconds")
"""Measures that a cell of a grid may show: the rate of success over its cases, or a mean over its successes."""


@dataclass(frozen=True)
class CaseRow:
    """A job of a campaign that has ended: its number, its id if it was not deleted, and its fields as text."""

    number: int
    job: str | None
    fields: Mapping[str, str]
    case: Case

    @property
    def counted(self) -> bool:
        """Whether the table counts it: the first answer was right, and it was not cancelled."""
        return self.case.right and self.case.state != "cancelled"


@dataclass(frozen=True)
class GridCell:
    """The counted cases of a row and a column, and the measure; None where no case has it."""

    success: Rate
    value: float | None
    share: float
    """Position of `value` between the smallest (0) and the largest (1) of the grid; a rate is its own position."""


@dataclass(frozen=True)
class Grid:
    """The measure by two fields. `cells` has a cell for each pair that has counted cases."""

    rows: list[str]
    columns: list[str]
    cells: dict[tuple[str, str], GridCell]


def grid(cases: Sequence[CaseRow], row: str, column: str, measure: str) -> Grid:
    """The measure, one of GRID_MEASURES, by two of CASE_FIELDS.

    Rows and columns are in the order in which they first occur, but numbers in their own.
    """
    groups: dict[tuple[str, str], list[Case]] = defaultdict(list)
    for case_row in cases:
        if case_row.counted:
            groups[case_row.fields[row], case_row.fields[column]].append(case_row.case)
    rates = {at: Rate.of_cases(sum(case.success for case in own), len(own)) for at, own in groups.items()}
    values = {
        at: rates[at].rate if measure == "success" else mean([getattr(case, measure) for case in own if case.success])
        for at, own in groups.items()
    }
    there = [value for value in values.values() if value is not None]
    low, high = (0.0, 1.0) if measure == "success" or not there else (min(there), max(there))
    return Grid(
        rows=_ordered([at for at, _ in groups]),
        columns=_ordered([at for _, at in groups]),
        cells={at: GridCell(rates[at], value, _share(value, low, high)) for at, value in values.items()},
    )


def _share(value: float | None, low: float, high: float) -> float:
    return 0.0 if value is None or high <= low else (value - low) / (high - low)


def _ordered(labels: Sequence[str]) -> list[str]:
    different = list(dict.fromkeys(labels))
    try:
        return sorted(different, key=lambda label: float(label.rstrip("°")))
    except ValueError:
        return different


def best(cases: Sequence[CaseRow], count: int) -> list[CaseRow]:
    """The successes that changed the image least, by p."""
    won = [row for row in cases if row.counted and row.case.success]
    return sorted(won, key=lambda row: (row.case.perceptibility or 0.0, row.number))[:count]


def worst(cases: Sequence[CaseRow], count: int) -> list[CaseRow]:
    """The counted cases that held longest, by queries; if they are too few, the successes that changed the image most
    follow.
    """
    held = [row for row in cases if row.counted and not row.case.success]
    won = [row for row in cases if row.counted and row.case.success]
    held.sort(key=lambda row: (-(row.case.queries or 0), row.number))
    won.sort(key=lambda row: (-(row.case.perceptibility or 0.0), row.number))
    return [*held, *won][:count]


@dataclass(frozen=True)
class PartMean:
    """A part of an attack: the mean Shapley value of the log-odds of the goal's label over `jobs` jobs.

    half: half the width of the mean's 95 % interval (normal approximation); None for a single job. first: the number of
    jobs in which no part moved the log-odds more.
    """

    target: str
    attack: str
    part: str
    jobs: int
    value: float
    half: float | None
    first: int


def part_means(attributions: Sequence[tuple[str, str, Mapping[str, Any]]]) -> list[PartMean]:
    """The means of (target, attack, attribution), in order of the target, attack and part that occur first.

    An attribution is that of scene_attack.analysis.records.Attribution as JSON data.
    """
    values: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    first: dict[tuple[str, str, str], int] = defaultdict(int)
    for target, attack, attribution in attributions:
        shapley = attribution["log_odds"]["shapley"]
        for part, value in zip(attribution["parts"], shapley, strict=True):
            values[target, attack, part].append(value)
            first[target, attack, part] += abs(value) == max(map(abs, shapley))
    return [
        PartMean(
            *at,
            jobs=len(own),
            value=sum(own) / len(own),
            half=NORMAL_95 * stdev(own) / len(own) ** 0.5 if len(own) > 1 else None,
            first=first[at],
        )
        for at, own in values.items()
    ]


COUNTS = ("jobs", "ended", "failed", "cancelled", "reused", "held_within_epsilon")
RATES = ("success", "loop_success")
OUTCOMES = ("fooled", "changed", "became-right", "still-wrong", "held")
_OF_CASE = tuple(name for name in Case.model_fields if name not in ("target", "attack", "second_opinion"))
_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{c: rf"\{c}" for c in "&%$#_{}"},
}


def to_csv(table: Table) -> str:
    """One line for each target and attack; rates and their intervals in [0,1], p in full range; empty where unknown."""
    rates = [f"{name}_{part}" for name in RATES for part in Rate.model_fields]
    means = ("perceptibility", "loop_perceptibility", "truncated")
    rows = [
        [
            *(table.campaign, cell.target, cell.attack),
            *(getattr(cell, name) for name in COUNTS),
            *(cell.outcomes.get(name, 0) for name in OUTCOMES),
            *(value for name in RATES for _, value in getattr(cell, name)),
            *(getattr(cell, name) for name in means),
            *(None if cell.survival is None else getattr(cell.survival, name) for name in Mean.model_fields),
            *(value for name in table.renderers for _, value in cell.second_opinion.get(name, Rate.of_cases(0, 0))),
        ]
        for cell in table.cells
    ]
    survival = [f"survival_{part}" for part in Mean.model_fields]
    opinions = [f"second_opinion_{name}_{part}" for name in table.renderers for part in Rate.model_fields]
    columns = ["campaign", "target", "attack", *COUNTS, *OUTCOMES, *rates, *means, *survival, *opinions]
    return _csv(columns, rows)


def cases_to_csv(cases: Sequence[CaseRow]) -> str:
    """One line for each job that has ended; p in full range, empty where unknown."""
    rows = [
        [
            *(row.number, row.job),
            *(row.fields[name] for name in CASE_FIELDS),
            *(getattr(row.case, name) for name in _OF_CASE),
            "; ".join(f"{renderer}: {word}" for renderer, word in row.case.second_opinion.items()),
        ]
        for row in cases
    ]
    return _csv(["number", "job", *(name.replace(" ", "_") for name in CASE_FIELDS), *_OF_CASE, "second_opinion"], rows)


def _csv(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(columns)
    lines.writerows([plain(value) for value in row] for row in rows)
    return out.getvalue()


def plain(value: object) -> object:
    """The value; a text that a spreadsheet would take for a formula is preceded by an apostrophe."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value


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
        for title, columns in _ROWS.items():
            pairs = (("--", "--") if cell is None else columns(cell) for cell in cells)
            lines.append(" & ".join([title or tex(target), *chain.from_iterable(pairs)]) + r" \\")
    lines += [
        r"\bottomrule",
        r"\end{tabular}",
        r"% Succ.: right before, fooled and verified on the exact image, in per cent; p: mean over these, times 1000.",
        r"% in the loop: fooled by the truncated image, as the paper counts, and the mean p of its float images.",
    ]
    return "\n".join(lines) + "\n"


def _interval(cell: Cell) -> tuple[str, str]:
    if cell.success.rate is None:
        return "--", "--"
    return f"[{_percent(cell.success.low)}, {_percent(cell.success.high)}]", str(cell.success.of)


def _percent(rate: float | None) -> str:
    return "--" if rate is None else f"{100 * rate:.1f}"


def _milli(value: float | None) -> str:
    return "--" if value is None else f"{1000 * value:.1f}"


_ROWS: dict[str, Callable[[Cell], tuple[str, str]]] = {
    "": lambda cell: (_percent(cell.success.rate), _milli(cell.perceptibility)),
    r"\quad 95\,\% interval, $n$": _interval,
    r"\quad in the loop": lambda cell: (_percent(cell.loop_success.rate), _milli(cell.loop_perceptibility)),
    r"\quad truncated pixels": lambda cell: ("--" if cell.truncated is None else f"{cell.truncated:.1f}", ""),
}
"""The rows of a target in LaTeX, by their title; the first one has the target's name."""


def tex(text: str) -> str:
    """The text with LaTeX's special characters escaped."""
    return "".join(_TEX.get(character, character) for character in text)
