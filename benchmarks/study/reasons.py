"""Why attacks on the scene succeed or fail: the share of the image that shows the object, confidence, and p."""

from collections.abc import Iterable, Sequence
from statistics import median_low

from benchmarks.study.record import Job, Record
from benchmarks.study.tables import NONE, OF, markdown, milli, title

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
            found = [[_range(low, high), *_row(own)] for (low, high), own in ranges.items() if own]
            rows += [[f"**{title(target)}**" if number == 0 else "", *row] for number, row in enumerate(found)]
            broad = [job for job in jobs if (job.share or 0.0) >= ENOUGH]
            if broad:
                sums.append(f"{title(target)} {' and '.join(f'{_rate(broad, name)} by {name}' for name in COLUMNS)}")
    if not rows:
        return NONE
    heads = ("network", "covered", "held", "views", *COLUMNS, "truncated")
    said = f"Of the views with at least {100 * ENOUGH:.0f} % covered are fooled: {'; '.join(sums)}."
    return f"{markdown(heads, rows, texts=3)}\n\n{said}"


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


def _range(low: float, high: float) -> str:
    if low == 0.0:
        return f"below {100 * high:.0f} %"
    return f"{100 * low:.0f}–{100 * high:.0f} %" if high <= 1 else f"{100 * low:.0f} % and more"


def _row(jobs: Sequence[Job]) -> list[str]:
    held = [job for job in jobs if not job.success]
    names = sorted({job.mesh.rpartition("/")[2] for job in held})
    counts = [_count([job for job in jobs if job.attack == name]) for name in COLUMNS]
    return [", ".join(names) or NONE, str(len({job.scene for job in jobs})), *counts, _pushed(held)]


def _count(jobs: Sequence[Job]) -> str:
    return f"{sum(job.success for job in jobs)}{OF}{len(jobs)}" if jobs else NONE


def _rate(jobs: Sequence[Job], attack: str) -> str:
    own = [job for job in jobs if job.attack == attack]
    return f"{100 * sum(job.success for job in own) / len(own):.1f} %" if own else NONE


def _pushed(held: Sequence[Job]) -> str:
    """Of the views that held, the share of covered pixels with a value beyond U in some step: the median."""
    return _middle((job.truncated or 0) / (job.covered or 1) for job in held)


def _sure(jobs: Sequence[Job]) -> str:
    return _middle(job.before_confidence for job in jobs)


def _far(jobs: Sequence[Job]) -> str:
    values = [job.p for job in jobs if job.p is not None]
    return milli(median_low(values) if values else None)


def _middle(shares: Iterable[float]) -> str:
    found = list(shares)
    return f"{100 * median_low(found):.0f}\u00a0%" if found else NONE
