"""The record of campaigns: the operations of clients. Those of the supervisor are in `campaign_feed`."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any
from uuid import uuid4

from sqlalchemy import func, select, tuple_, update
from sqlalchemy.orm import Session, defer, undefer

from services.analysis.campaign_curves import Curves
from services.analysis.campaign_table import Case
from services.errors import QuotaExceeded
from services.jobs.asset_uses import check_held, refer_from_campaign, uploads_among
from services.jobs.campaign_cases import CampaignCases
from services.jobs.models import Campaign, CampaignJob, CampaignState, Job, JobKind, State
from services.jobs.placement import CAMPAIGNS, Demand
from services.jobs.repository import Key, KeyReused
from services.jobs.utc_time import place
from services.pipeline.campaign_check import check_meshes, meshes_of
from services.pipeline.campaign_spec import CampaignSpec

ENDED_SECONDS = 60.0
"""Time after which an owner with too many campaigns may try again."""
_OPEN = [state for state in CampaignState if not state.terminal]


@dataclass(frozen=True)
class Progress:
    """How far a campaign is."""

    views_answered: int
    jobs: int
    ended: int
    running: int


class Campaigns(CampaignCases):
    """The record of campaigns, as clients see and change it."""

    def create(
        self,
        spec: CampaignSpec,
        view_count: int,
        digest: str,
        key: str | None,
        owner: str = "",
        demand: Demand = CAMPAIGNS,
        owner_campaigns: int | None = None,
    ) -> Campaign:
        """Records a new campaign and returns it, or the first one of the key if it was used before.

        Raises KeyReused if the key came with another request, QuotaExceeded if `owner_campaigns` of the owner have not
        ended, InvalidRequest if a mesh of the request was deleted, and IntegrityError if another process records the
        same key at the same moment.
        """
        with self._write(durable=True) as session:
            given = None if key is None else Key(key, digest, owner)
            if given is not None and (first := _first(session, given)) is not None:
                return first
            if owner_campaigns is not None:
                own = (Campaign.owner == owner, Campaign.state.in_(_OPEN))
                if (session.scalar(select(func.count()).select_from(Campaign).where(*own)) or 0) >= owner_campaigns:
                    detail = f"an owner may have {owner_campaigns:,} campaigns that have not ended"
                    raise QuotaExceeded(detail, ENDED_SECONDS)
            uploads = uploads_among(meshes_of(spec))
            check_held(session, uploads, partial(check_meshes, spec))
            campaign = Campaign(
                id=uuid4().hex,
                name=spec.name,
                state=CampaignState.SELECTING,
                spec=spec.model_dump(mode="json"),
                created_at=self._now(session),
                view_count=view_count,
                key=None if given is None else given.stored,
                owner=owner,
                demand=demand.record(),
                request_digest=digest,
            )
            session.add(campaign)
            session.flush()
            refer_from_campaign(session, campaign.id, uploads)
            return campaign

    def of_key(self, key: Key) -> Campaign | None:
        """The campaign of the first request with this key, or None for a new key. Raises KeyReused."""
        with self._read() as session:
            return _first(session, key)

    def get(self, campaign_id: str, *, whole: bool = False) -> Campaign | None:
        """A campaign, or None if the id is unknown; `whole` reads its spec and its views, too."""
        options = [undefer(Campaign.spec), undefer(Campaign.views)] if whole else []
        with self._read() as session:
            return session.get(Campaign, campaign_id, options=options)

    def page(
        self, state: CampaignState | None, limit: int, before: tuple[datetime, str] | None, owner: str | None = None
    ) -> list[Campaign]:
        """At most `limit` campaigns, newest first, older than `before`, a campaign's (created_at, id). If given, only
        those in `state`, and only those of an owner.
        """
        query = select(Campaign).order_by(Campaign.created_at.desc(), Campaign.id.desc()).limit(limit)
        if state is not None:
            query = query.where(Campaign.state == state)
        if owner is not None:
            query = query.where(Campaign.owner == owner)
        if before is not None:
            query = query.where(tuple_(Campaign.created_at, Campaign.id) < place(before))
        with self._read() as session:
            return list(session.scalars(query))

    def pause(self, campaign_id: str) -> Campaign | None:
        """Holds the campaign's queued jobs back; running jobs go on to their end. Returns it, or None if unknown."""
        active = (CampaignState.SELECTING, CampaignState.RUNNING)
        with self._write() as session:
            self._set(session, campaign_id, active, state=CampaignState.PAUSED, paused_at=self._now(session))
            return session.get(Campaign, campaign_id)

    def resume(self, campaign_id: str) -> Campaign | None:
        """Lets the jobs of a paused campaign go on. Returns the campaign, or None if the id is unknown."""
        with self._write() as session:
            campaign = session.get(Campaign, campaign_id, with_for_update=True)
            if campaign is not None and campaign.state is CampaignState.PAUSED:
                campaign.state = CampaignState.SELECTING if campaign.selected_at is None else CampaignState.RUNNING
                campaign.paused_at = None
            return campaign

    def cancel(self, campaign_id: str) -> Campaign | None:
        """Cancels the campaign: its queued jobs at once, its running jobs within a step; no more are queued.

        Returns the campaign, or None if the id is unknown.
        """
        with self._write() as session:
            if self._set(
                session,
                campaign_id,
                _OPEN,
                state=CampaignState.CANCELLED,
                ended_at=self._now(session),
                paused_at=None,
            ):
                own = (Job.campaign_id == campaign_id, Job.state.in_((State.QUEUED, State.RUNNING)))
                for job_id in session.scalars(select(Job.id).where(*own).order_by(Job.id).with_for_update()).all():
                    if self._move(session, job_id, State.CANCELLED, [Job.state == State.QUEUED]) is None:
                        self._move(session, job_id, State.CANCELLING, [Job.state == State.RUNNING])
            return session.get(Campaign, campaign_id)

    def _set(self, session: Session, campaign_id: str, states: Sequence[CampaignState], **values: Any) -> bool:
        changed = (
            update(Campaign)
            .where(Campaign.id == campaign_id, Campaign.state.in_(states))
            .values(**values)
            .returning(Campaign.id)
        )
        return session.scalar(changed) is not None

    def progress(self, campaign_ids: Sequence[str]) -> dict[str, Progress]:
        """How far each of these campaigns is."""
        own = Job.campaign_id.in_(campaign_ids)
        with self._read() as session:
            answered = session.execute(
                select(Job.campaign_id, func.sum(Job.step))
                .where(own, Job.kind == JobKind.SELECTION)
                .group_by(Job.campaign_id)
            ).all()
            running = session.execute(
                select(Job.campaign_id, func.count()).where(own, Job.state == State.RUNNING).group_by(Job.campaign_id)
            ).all()
            ended = session.execute(
                select(CampaignJob.campaign_id, CampaignJob.ended, func.count())
                .where(CampaignJob.campaign_id.in_(campaign_ids))
                .group_by(CampaignJob.campaign_id, CampaignJob.ended)
            ).all()
        views = {campaign: int(count or 0) for campaign, count in answered}
        busy = {row[0]: row[1] for row in running}
        by_end = {(campaign, end): count for campaign, end, count in ended}
        return {
            one: Progress(
                views_answered=views.get(one, 0),
                jobs=by_end.get((one, False), 0) + by_end.get((one, True), 0),
                ended=by_end.get((one, True), 0),
                running=busy.get(one, 0),
            )
            for one in campaign_ids
        }

    def cases(self, campaign_id: str) -> tuple[list[tuple[str, str]], list[Case]]:
        """(target, attack) of every planned job, and the cases of those that have ended, both in their order."""
        columns = select(CampaignJob.target, CampaignJob.attack, CampaignJob.ended, CampaignJob.case)
        with self._read() as session:
            rows = session.execute(
                columns.where(CampaignJob.campaign_id == campaign_id).order_by(CampaignJob.number)
            ).all()
        return [(row.target, row.attack) for row in rows], [Case.model_validate(row.case) for row in rows if row.ended]

    def curves(self, campaign_id: str) -> list[tuple[str, str, Curves]]:
        """Target, attack and curves of every job that ran to its end on a view whose first answer was right."""
        own = (CampaignJob.campaign_id == campaign_id, CampaignJob.ended, CampaignJob.right)
        columns = select(CampaignJob.target, CampaignJob.attack, CampaignJob.curves).where(*own)
        with self._read() as session:
            rows = session.execute(columns.order_by(CampaignJob.number)).all()
        return [(row.target, row.attack, Curves.model_validate(row.curves)) for row in rows if row.curves is not None]

    def jobs(self, campaign_id: str, limit: int, after: int) -> list[tuple[CampaignJob, Job | None]]:
        """At most `limit` planned jobs with a number above `after`, in order, each with its job if it has one."""
        query = (
            select(CampaignJob, Job)
            .outerjoin(Job, Job.id == CampaignJob.job_id)
            .where(CampaignJob.campaign_id == campaign_id, CampaignJob.number > after)
            .order_by(CampaignJob.number)
            .limit(limit)
            .options(defer(Job.spec))
        )
        with self._read() as session:
            return [(planned, job) for planned, job in session.execute(query)]


def _first(session: Session, key: Key) -> Campaign | None:
    first = session.scalars(select(Campaign).where(Campaign.key == key.stored)).one_or_none()
    if first is not None and first.request_digest != key.digest:
        raise KeyReused
    return first
