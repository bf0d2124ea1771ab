"""Shows a running campaign on the terminal: a bar with the time left, or, without a terminal, a line now and then."""

from time import monotonic
from typing import TYPE_CHECKING

from client.campaign_tables import duration
from client.live import LOG_EVERY, ProgressLine

if TYPE_CHECKING:
    from services.pipeline.campaign_run import CampaignProgress


class CampaignLine(ProgressLine):
    """Shows the progress of a campaign."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._logged = float("-inf")

    def update(self, progress: "CampaignProgress") -> None:
        """Shows how far the campaign is."""
        things = "views" if progress.phase == "selecting" else "jobs"
        won = sum(case.success for case in progress.cases)
        left = duration(progress.seconds_left)
        parts = [f"{won} successes" if progress.cases else "", f"{left} left" if left else "", progress.now]
        now = "  ".join(part for part in parts if part)
        self._bar.update(self._task, description=progress.phase, completed=progress.done, total=progress.total, now=now)
        last = progress.done == progress.total
        if self._log is not None and (last or monotonic() - self._logged > LOG_EVERY):
            self._logged = monotonic()
            line = f"{progress.phase} {progress.done}/{progress.total} {things}  {now}"
            self._log.print(line, markup=False, highlight=False)
