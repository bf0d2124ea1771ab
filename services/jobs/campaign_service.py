"""Campaigns for the API and the dashboard: submission, and results from the record, without HTTP."""

from collections import Counter
from dataclasses import dataclass
from hashlib import sha256
from math import degrees

from redis.exceptions import RedisError
from sqlalchemy.exc import IntegrityError

from services.analysis.campaign_curves import mean_curves
from services.analysis.campaign_table import table
from services.analysis.case_rows import CaseRow
from services.analysis.time_left import time_left
from services.jobs.campaign_cases import EndedJob
from services.jobs.campaigns import Campaigns, Progress
from services.jobs.models import Campaign
from services.jobs.placement import CAMPAIGNS, Demand
from services.jobs.queue import Queue
from services.pipeline.campaign_expand import views
from services.pipeline.campaign_result import CampaignResult
from services.pipeline.campaign_select import ChosenView
from services.pipeline.campaign_spec import CampaignSpec


@dataclass(frozen=True)
class Counts:
    """The results of a campaign so far, in numbers."""

    outcomes: dict[str, int]
    successes: int
    reused: int
    seconds_left: float | None


@dataclass(frozen=True)
class CampaignService:
    """What doors do with campaigns."""

    record: Campaigns
    queue: Queue

    def submit(
        self,
        spec: CampaignSpec,
        key: str | None,
        owner: str = "",
        demand: Demand = CAMPAIGNS,
        owner_campaigns: int | None = None,
    ) -> Campaign:
        """Records a checked campaign; the supervisor queues its jobs. Returns it, or the first one of the key.

        Raises KeyReused if the key came with another request, and QuotaExceeded if `owner_campaigns` of the owner have
        not ended.
        """
        given = (spec, len(views(spec)), request_digest(spec), key, owner, demand, owner_campaigns)
        try:
            return self.record.create(*given)
        except IntegrityError:  # another process recorded the same key at the same moment
            return self.record.create(*given)

    def counts(self, campaign_id: str) -> Counts:
        """The results so far, and the time left with as many workers as there are now."""
        planned, cases = self.record.cases(campaign_id)
        try:
            workers = self.queue.live_workers()
        except RedisError:
            workers = 1
        return Counts(
            outcomes=dict(sorted(Counter(case.outcome for case in cases if case.outcome is not None).items())),
            successes=sum(case.success for case in cases),
            reused=sum(case.reused for case in cases),
            seconds_left=time_left(planned, cases, workers) if planned else None,
        )

    def result(self, campaign: Campaign, *, curves: bool = True) -> CampaignResult:
        """The table so far; the campaign must have been read whole. `curves` reads the curves of all traces, too."""
        planned, cases = self.record.cases(campaign.id)
        return CampaignResult(
            table=table(campaign.name, planned, cases),
            curves=mean_curves(self.record.curves(campaign.id)) if curves else [],
            views=[ChosenView.model_validate(view) for view in campaign.views or []],
        )

    def cases(self, campaign: Campaign) -> list[CaseRow]:
        """The jobs that have ended, with what they are about; the campaign must have been read whole."""
        views = [ChosenView.model_validate(view) for view in campaign.views or []]
        by_number = {view.number: view for view in views}
        return [_case_row(one, by_number.get(one.view)) for one in self.record.ended(campaign.id)]

    def progress(self, campaign: Campaign) -> Progress:
        """How far the campaign is."""
        return self.record.progress([campaign.id])[campaign.id]


def _case_row(one: EndedJob, view: ChosenView | None) -> CaseRow:
    fields = {"target": one.case.target, "attack": one.case.attack, "seed": str(one.seed)}
    about = {
        "scene": view.scene if view else "",
        "azimuth": f"{degrees(view.azimuth):.0f}°" if view else "",
        "truth": ", ".join(view.truth) if view else "",
        "first answer": (view.label or "") if view else "",
    }
    return CaseRow(one.number, one.job, fields | about, one.case)


def request_digest(spec: CampaignSpec) -> str:
    """Hex SHA-256 of a request with its defaults filled in, by which an idempotency key recognises it."""
    return sha256(spec.model_dump_json().encode()).hexdigest()
