"""The tables of what verified adversaries survive: cameras that take their image."""

from benchmarks.study.record import Job, Record
from benchmarks.study.tables import NONE, OF, bold, markdown, milli, ordered, title
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
