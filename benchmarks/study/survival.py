"""The tables of what verified adversaries survive: cameras that take their image, and renderers that draw them."""

from collections.abc import Sequence

from benchmarks.study.examples import Example
from benchmarks.study.record import Job, Record
from benchmarks.study.tables import NONE, OF, bold, markdown, milli, ordered, title
from scene_attack.analysis.campaign_table import Mean, Rate, mean

HALF = 0.5
"""Share of the cameras from which an adversary counts as one that survives."""


def before_cameras(record: Record) -> str:
    """For each network and attack the verified adversaries, the mean share of cameras before which they fool, and how
    many fool before at least half of them.
    """
    rows = []
    for target in ordered(record.table().targets):
        block = []
        for attack in record.table().attacks:
            jobs = [job for job in record.jobs if (job.target, job.attack) == (target, attack) and job.right]
            if jobs:
                block.append([attack, *_row(jobs)])
        rows += [[f"**{title(target)}**" if place == 0 else "", *row] for place, row in enumerate(block)]
    heads = ("verified", "p ×10⁻³", "right before cameras, %", "survival, %", "95 % interval", "before half of them")
    return markdown(("network", "attack", *heads), rows, texts=2)


def drawn_by_others(record: Record) -> str:
    """For each network and attack how many of the verified adversaries fool when each other renderer draws them, of
    those whose scene the network has right there.
    """
    table, rows = record.table(), []
    for target in ordered(table.targets):
        block = []
        for cell in (cell for cell in table.cells if cell.target == target):
            verified = f"{cell.success.count}{OF}{cell.success.of}"
            opinions = (cell.second_opinion.get(renderer) for renderer in table.renderers)
            block.append([cell.attack, verified, milli(cell.perceptibility), *map(_survivors, opinions)])
        rows += [[f"**{title(target)}**" if place == 0 else "", *row] for place, row in enumerate(block)]
    return markdown(("network", "attack", "verified", "p ×10⁻³", *table.renderers), rows, texts=2)


def _survivors(rate: Rate | None) -> str:
    """A count of survivors, and its interval in per cent."""
    if rate is None or rate.low is None or rate.high is None:
        return NONE
    return f"{bold(f'{rate.count}{OF}{rate.of}')}<br>{100 * rate.low:.0f}–{100 * rate.high:.0f} %"


def pictures(examples: Sequence[Example]) -> str:
    """The examples as each renderer draws them: the image by which they were verified, then those of the others."""
    rows = []
    for example in examples:
        about = f"{title(example.target)}, {example.attack}, p {1e3 * example.p:.1f}"
        before = f"{example.before}, {example.before_confidence:.0%}<br>{about}"
        after = f"**{example.after}**, {example.after_confidence:.0%}"
        others = (f"{one.after}, {one.after_confidence:.0%}: {one.outcome}" for one in example.opinions)
        images = ("before", "attacked", *(one.renderer for one in example.opinions))
        notes = (before, after, *others)
        rows.append(
            [f"![{image}]({example.name}-{image}.png)<br>{note}" for image, note in zip(images, notes, strict=True)]
        )
    renderers = [one.renderer for one in examples[0].opinions] if examples else []
    return markdown(("before", "verified", *renderers), rows, texts=len(renderers) + 2)


def _row(jobs: list[Job]) -> list[str]:
    won = [job for job in jobs if job.success]
    taken = [job.survival for job in won if job.survival is not None]
    shares = [one.fooled / one.right for one in taken if one.right]
    survived = Mean.of_shares(shares)
    between = NONE if survived is None else f"{100 * survived.low:.0f}–{100 * survived.high:.0f}"
    return [
        f"{len(won)}{OF}{len(jobs)}",
        milli(mean([job.p for job in won])),
        _percent(mean([one.right / one.views for one in taken])),
        bold(_percent(None if survived is None else survived.mean)),
        between,
        f"{sum(share >= HALF for share in shares)}{OF}{len(shares)}",
    ]


def _percent(share: float | None) -> str:
    return NONE if share is None else f"{100 * share:.0f}"
