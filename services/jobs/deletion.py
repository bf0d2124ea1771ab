"""Deletes jobs that have ended from the record: one that a client names, or all that are older than is kept."""

from collections.abc import Collection, Sequence
from datetime import timedelta

from sqlalchemy import ColumnElement, delete, func, or_, select
from sqlalchemy.orm import Session

from services.errors import InUse
from services.jobs.models import Artifact, Campaign, CampaignJob, Job, State
from services.jobs.transactions import Transactions

AT_ONCE = 200
"""Jobs that one transaction deletes, and hashes that one query looks for."""


class Deletions(Transactions):
    """Deletes jobs with their events, artifacts and keys. The files are left to `services.jobs.housekeeping`."""

    def delete(self, job_id: str) -> list[str]:
        """Deletes a job and returns the hashes of its files. Does nothing if there is no such job.

        Raises InUse if the job has not ended or a campaign refers to it.
        """
        with self._write() as session:
            self._lock(session, job_id)
            found = session.execute(select(Job.state).where(Job.id == job_id)).one_or_none()
            if found is None:
                return []
            if not found.state.terminal:
                raise InUse(f"the job is {found.state.value}; cancel it, and delete it once it has ended")
            campaign = session.scalar(select(CampaignJob.campaign_id).where(CampaignJob.job_id == job_id).limit(1))
            if campaign is not None:
                raise InUse(f"the campaign {campaign} refers to the job")
            return self._delete(session, [job_id])

    def expire(self, days: float) -> list[str]:
        """Deletes campaigns that ended more than `days` ago, and at most `AT_ONCE` jobs that did and that no campaign
        refers to. Returns the hashes of their files.
        """
        with self._write() as session:
            before = self._now(session) - timedelta(days=days)
            session.execute(delete(Campaign).where(Campaign.ended_at < before))
            ended = func.coalesce(Job.succeeded_at, Job.failed_at, Job.rejected_at, Job.cancelled_at)
            over = Job.state.in_([state for state in State if state.terminal])
            old = select(Job.id).where(over, ended < before, _of_no_campaign()).order_by(Job.id).limit(AT_ONCE)
            return self._delete(session, session.scalars(old.with_for_update()).all())

    def unnamed(self, hashes: Collection[str]) -> set[str]:
        """Those of some hashes that no job's artifact has."""
        left, asked = set(hashes), sorted(hashes)
        with self._read() as session:
            for start in range(0, len(asked), AT_ONCE):
                some = asked[start : start + AT_ONCE]
                left -= set(session.scalars(select(Artifact.sha256).where(Artifact.sha256.in_(some))))
        return left

    def _delete(self, session: Session, ids: Sequence[str]) -> list[str]:
        hashes = session.scalars(select(Artifact.sha256).where(Artifact.job_id.in_(ids)).distinct()).all()
        session.execute(delete(Job).where(Job.id.in_(ids)))  # the rest of a job's rows go with it
        return list(hashes)


def _of_no_campaign() -> ColumnElement[bool]:
    named = select(CampaignJob.job_id).where(CampaignJob.job_id == Job.id).exists()
    there = select(Campaign.id).where(Campaign.id == Job.campaign_id).exists()
    return ~named & or_(Job.campaign_id.is_(None), ~there)
