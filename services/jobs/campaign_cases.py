"""The cases of a campaign one by one, for what is shown beside its table."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import select

from services.analysis.campaign_table import Case
from services.jobs.models import CampaignJob, Job
from services.jobs.transactions import Transactions


@dataclass(frozen=True)
class EndedJob:
    """A planned job that has ended: its number in the campaign, that of its view, its seed, its id, and its case.

    The id is None if the job was deleted since.
    """

    number: int
    view: int
    seed: int
    job: str | None
    case: Case


class CampaignCases(Transactions):
    """Reads the record by case."""

    def ended(self, campaign_id: str) -> list[EndedJob]:
        """The jobs of a campaign that have ended, in their order."""
        query = (
            select(
                CampaignJob.number,
                CampaignJob.view,
                CampaignJob.job_id,
                CampaignJob.case,
                CampaignJob.spec["seed"].as_integer().label("seed"),
            )
            .where(CampaignJob.campaign_id == campaign_id, CampaignJob.ended)
            .order_by(CampaignJob.number)
        )
        with self._read() as session:
            rows = session.execute(query).all()
        return [EndedJob(row.number, row.view, row.seed, row.job_id, Case.model_validate(row.case)) for row in rows]

    def attributions(self, campaign_id: str, limit: int) -> list[tuple[str, str, dict[str, Any]]]:
        """Target, attack and attribution (services.analysis.records.Attribution) of the first `limit` jobs with a
        result, in their order; without those that have none.
        """
        attribution = Job.result["attribution"].as_json().label("attribution")
        query = (
            select(CampaignJob.target, CampaignJob.attack, attribution)
            .join(Job, Job.id == CampaignJob.job_id)
            .where(CampaignJob.campaign_id == campaign_id, CampaignJob.ended, Job.result.is_not(None))
            .order_by(CampaignJob.number)
            .limit(limit)
        )
        with self._read() as session:
            rows = session.execute(query).all()
        return [(row.target, row.attack, row.attribution) for row in rows if row.attribution]
