"""The tables of what verified adversaries survive: cameras that take their image, and renderers that draw them."""

from collections.abc import Sequence

from benchmarks.study.examples import Example
from benchmarks.study.record import Job, Record
from benchmarks.study.tables import NONE, OF, bold, markdown, milli, ordered, rate_texts, title
from scene_attack.analysis.campaign_table import Mean, mean

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
    """For each network, attack and renderer how many of the verified adversaries fool when it draws them."""
    table, rows = record.table(), []
    for target in ordered(table.targets):
        block = []
        for cell in (cell for cell in table.cells if cell.target == target):
            verified = f"{cell.success.count}{OF}{cell.success.of}"
            for renderer, rate in cell.second_opinion.items():
                count, share, between = rate_texts(rate)
                block.append([cell.attack, renderer, verified, milli(cell.perceptibility), bold(count), share, between])
        rows += [[f"**{title(target)}**" if place == 0 else "", *row] for place, row in enumerate(block)]
    heads = ("verified", "p ×10⁻³", "fool there", "%", "95 % interval")
    return markdown(("network", "attack", "drawn by", *heads), rows, texts=3)


def pictures(examples: Sequence[Example]) -> str:
    """The examples as each renderer draws them: the image by which they were verified, then those of the others."""
    rows = []
    for example in examples:
        before = f"![before]({example.name}-before.png)<br>{example.before}, {example.before_confidence:.0%}"
        own = f"![attacked]({example.name}-attacked.png)<br>**{example.after}**, {example.after_confidence:.0%}"
        others = [
            f"![{one.renderer}]({example.name}-{one.renderer}.png)<br>{one.renderer}: {one.after}, "
            f"{one.after_confidence:.0%}: {one.outcome}"
            for one in example.opinions
        ]
        rows.append([f"{title(example.target)}, {example.attack}<br>p {1e3 * example.p:.1f}", before, own, *others])
    renderers = [one.renderer for one in examples[0].opinions] if examples else []
    return markdown(("attack", "before", "verified", *renderers), rows, texts=len(renderers) + 3)


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
