"""The tables of the study of physical changes: success and p of every group, by wavelength, and by views around."""

from collections.abc import Sequence
from statistics import median

from benchmarks.study.record import Around, Job, Record
from benchmarks.study.tables import (
    BETWEEN,
    NONE,
    OF,
    RANGES,
    SETTING,
    bold,
    decimal,
    fooled_of,
    markdown,
    milli,
    ordered,
    paper,
    rate_texts,
    share_range,
    title,
)
from scene_attack.analysis.campaign_table import Rate, mean

SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the views around an object that must be fooled at once."""


def changes(records: Sequence[Record]) -> str:
    """For each network the paper's columns, and ours: views fooled, with interval, p and steps."""
    rows: list[list[str]] = []
    theirs = paper()["classification"]["differentiable"]
    for target in ordered({target for record in records for target in record.table().targets}):
        block = []
        stated = theirs["targets"].get(target)
        if stated is not None:
            values = zip(theirs["columns"], stated["success"], stated["p"], strict=True)
            block += [
                [f"paper: {name}", str(theirs["views"]), f"{rate:.1f}", "", f"{p:.1f}", ""]
                for name, rate, p in values
                if name != "image"
            ]
        jobs = [job for record in records for job in record.jobs if job.target == target and job.right]
        for attack in dict.fromkeys(job.attack for job in jobs if SETTING not in job.attack):
            block.append([attack, *_row([job for job in jobs if job.attack == attack])])
        rows += [[f"**{title(target)}**" if place == 0 else "", *row] for place, row in enumerate(block)]
    heads = ("network", "attack", "n", "fooled, %", "95 % interval", "p ×10⁻³", "steps")
    return markdown(heads, rows, texts=2)


def by_coverage(records: Sequence[Record]) -> str:
    """For each network and each range of covered shares: the views that each attack fools."""
    rows = []
    everywhere = [job for record in records for job in record.jobs if job.right and SETTING not in job.attack]
    names = list(dict.fromkeys(job.attack for job in everywhere))
    for target in ordered({job.target for job in everywhere}):
        jobs = [job for job in everywhere if job.target == target]
        block = []
        for low, high in RANGES:
            own = [[j for j in jobs if j.attack == name and low <= (j.share or 0.0) < high] for name in names]
            block.append([share_range(low, high), *map(fooled_of, own)])
        rows += [[f"**{title(target)}**" if place == 0 else "", *row] for place, row in enumerate(block)]
    return markdown(("network", "covered", *names), rows, texts=2)


def _row(jobs: Sequence[Job]) -> list[str]:
    """Number of views, per cent fooled with interval, and of the fooled the mean p and the median step."""
    won = [job for job in jobs if job.success]
    _, fooled, between = rate_texts(Rate.of_cases(len(won), len(jobs)))
    steps = [job.step for job in won if job.step is not None]
    middle = decimal(median(steps) if steps else None, 0)
    return [str(len(jobs)), bold(fooled), between, milli(mean([job.p for job in won])), middle]


def by_wavelength(record: Record) -> str:
    """The columns "<group>, <wavelength>" beside the group's own, on the views that all of them attacked."""
    columns = [attack for attack in record.table().attacks if SETTING in attack]
    rows = []
    for group in dict.fromkeys(column.partition(SETTING)[0] for column in columns):
        names = [group, *(column for column in columns if column.partition(SETTING)[0] == group)]
        seen = [{(job.target, job.scene) for job in record.jobs if job.attack == name} for name in names]
        shared = set.intersection(*seen)
        for name in names:
            jobs = [
                job for job in record.jobs if job.attack == name and (job.target, job.scene) in shared and job.right
            ]
            rows.append([group, name.partition(SETTING)[2] or "0.1", *_row(jobs)])
    return markdown(("attack", "shortest wave", "n", "fooled, %", "95 % interval", "p ×10⁻³", "steps"), rows)


def around(record: Record) -> str:
    """For each object the views around it that each attack fools, the largest in the image first; and below how many
    objects are fooled from at least a share of their views.
    """
    names = record.table().attacks
    jobs = {(job.mesh, job.attack): job for job in record.jobs}
    rows = []
    for mesh in dict.fromkeys(job.mesh for job in sorted(record.jobs, key=lambda job: -(job.share or 0.0))):
        own = [jobs.get((mesh, name)) for name in names]
        first = next(job for job in own if job is not None)
        covered = NONE if first.share is None else f"{100 * first.share:.0f} %"
        rows.append([mesh.rpartition("/")[2], first.before, covered, *map(_seen, own)])
    for share in SHARES:
        held = [[job for job in record.jobs if job.attack == name and job.around is not None] for name in names]
        cells = [f"{sum(_reaches(job.around, share) for job in own)}{OF}{len(own)}" for own in held]
        text = "all" if share == 1 else f"at least {100 * share:.0f} %"
        rows.append([f"**objects fooled from {text} of their views**", "", "", *cells])
    return markdown(("object", "kind", "covered", *names), rows, texts=2)


def _seen(job: Job | None) -> str:
    if job is None or job.around is None:
        return NONE
    return f"{job.around.fooled}{OF}{job.around.right}{BETWEEN}{milli(job.p)}"


def _reaches(seen: Around | None, share: float) -> bool:
    return seen is not None and seen.right > 0 and seen.fooled >= share * seen.right
