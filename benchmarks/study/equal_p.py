"""The study's comparison at equal perceptibility: a campaign whose columns are attacks, each under several limits of p.

A column is called "<attack>, p ≤ <limit in thousandths>". A success counts if the verified adversary's own p, of the
exact image, is within the limit. All attacks of a network have the same views and the same budget of queries.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.study.curves import Panel, Series, figure
from benchmarks.study.record import Job, Record
from benchmarks.study.tables import NONE, OF, markdown, title
from scene_attack.analysis.campaign_table import Corners, Rate, corners, share_at

BETWEEN = ", p ≤ "
BUDGETS = (30, 100, 300, 1000)
"""Queries within which successes are stated, besides the whole budget."""


@dataclass(frozen=True)
class Run:
    """All jobs of one attack on one network under one limit of p."""

    attack: str
    limit: float
    """In thousandths."""
    jobs: Sequence[Job]

    @property
    def won(self) -> list[Job]:
        """The jobs that succeeded within the limit."""
        return [job for job in self.jobs if job.success and job.p is not None and 1000 * job.p <= self.limit]

    @property
    def by_queries(self) -> Corners:
        """Corners of the number of successes against queries."""
        return corners([job.queries for job in self.won])


def runs(record: Record, target: str) -> list[Run]:
    """The runs on one network, in the order of the campaign. Raises ValueError for a column of another form of name."""
    all_runs = []
    for attack in record.table().attacks:
        own = [job for job in record.jobs if (job.target, job.attack) == (target, attack) and job.right]
        name, between, limit = attack.rpartition(BETWEEN)
        if not between:
            raise ValueError(f"the column {attack!r} states no limit: <attack>{BETWEEN}<thousandths>")
        if own:
            all_runs.append(Run(name, float(limit), own))
    return all_runs


def section(record: Record) -> str:
    """The table of all networks, and their curves."""
    parts = [_table(record)]
    for target in record.table().targets:
        parts.append(f"![{title(target)}: success against p and against queries]({chart_name(target)})")
    return "\n\n".join(parts)


def chart_name(target: str) -> str:
    """The file of a network's curves."""
    return f"equal-p-{target}.svg"


def draw(record: Record, target: str) -> str:
    """The curves of one network: success against p, and against queries under each limit."""
    own = runs(record, target)
    names = list(dict.fromkeys(run.attack for run in own))
    limits = sorted({run.limit for run in own})
    most = max([job.queries or 1 for run in own for job in run.jobs], default=10)
    share = _top(max((len(run.won) / len(run.jobs) for run in own if run.jobs), default=0.0))
    against_p = Panel(
        f"{title(target)}: success against p",
        "p ×10⁻³ of the verified adversary",
        "% of all views",
        [_by_p(name, [run for run in own if run.attack == name]) for name in names],
        (0.0, limits[-1]),
        (0.0, share),
        lines=limits,
    )
    panels = [against_p]
    for limit in limits:
        series = [
            Series(run.attack, [(1.0, 0.0), *((q, 100 * n / len(run.jobs)) for q, n in run.by_queries)], steps=True)
            for run in own
            if run.limit == limit
        ]
        panels.append(
            Panel(
                f"p ≤ {limit:g} ×10⁻³",
                "queries (logarithmic)",
                "% of all views",
                series,
                (1.0, max(10.0, 1.05 * most)),
                (0.0, share),
                logarithmic=True,
            )
        )
    return figure(panels, names)


def _top(share: float) -> float:
    """The upper end of an axis of per cent, the same on all panels of a figure: a fifth more than the largest share."""
    return next((float(end) for end in (10, 20, 50) if end >= 120 * share), 100.0)


def _by_p(name: str, own: Sequence[Run]) -> Series:
    """Successes against the smallest p with which a view was fooled, under whichever limit."""
    smallest: dict[tuple[str, float, int], float] = {}
    for run in own:
        for job in run.won:
            key, p = (job.mesh, job.azimuth, job.seed), 1000 * (job.p or 0.0)
            smallest[key] = min(p, smallest.get(key, p))
    of = max(len(run.jobs) for run in own)
    return Series(name, [(0.0, 0.0), *((p, 100 * n / of) for p, n in corners(list(smallest.values())))], steps=True)


def _table(record: Record) -> str:
    rows = []
    for target in record.table().targets:
        for number, run in enumerate(sorted(runs(record, target), key=lambda run: run.limit)):
            rate = Rate.of_cases(len(run.won), len(run.jobs))
            shares = (100 * share_at(run.by_queries, len(run.jobs), budget) for budget in BUDGETS)
            interval = NONE if rate.low is None or rate.high is None else f"{100 * rate.low:.0f}–{100 * rate.high:.0f}"
            rows.append(
                [
                    f"**{title(target)}**" if number == 0 else "",
                    f"{run.limit:g}",
                    run.attack,
                    *(f"{share:.0f}" for share in shares),
                    f"**{100 * (rate.rate or 0.0):.0f}**",
                    f"{rate.count}{OF}{rate.of}",
                    interval,
                ]
            )
    within = (f"{budget:,} queries" for budget in BUDGETS)
    return markdown(("network", "p ≤ ×10⁻³", "attack", *within, "all", "", "95 % interval"), rows, texts=3)
