"""Moves campaigns on: the supervisor calls `Feeder.tick` once a second.

A campaign first asks the networks for their first answers, in selection jobs of a few views each. Its jobs are then
planned, and queued a few at a time, so that single jobs never wait behind more than a few of them. Everything is in
the database, so that any supervisor goes on where another one stopped.
"""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Engine, func, select, update
from sqlalchemy.orm import Session, undefer

from services.analysis.campaign_table import Case
from services.jobs.asset_uses import titles
from services.jobs.models import Campaign, CampaignJob, CampaignState, Job, JobKind, State
from services.jobs.placement import CAMPAIGNS, Demand
from services.jobs.transactions import Transactions, not_held
from services.logs import logger
from services.pipeline.campaign_case import case_of, curves_of, curves_record, reusable, unfinished
from services.pipeline.campaign_expand import View, filled, jobs, views
from services.pipeline.campaign_select import FirstAnswer, choose, meshes_of
from services.pipeline.campaign_spec import CampaignSpec
from services.pipeline.result import Result
from services.pipeline.spec import digest

CHUNK = 16
"""Views of one selection job, which takes a few seconds."""
AT_ONCE = 50
"""Planned jobs of a campaign that one tick looks at: ended ones to read, or ones with an earlier result to take."""

log = logger(__name__)


class Feeder(Transactions):
    """Moves campaigns on. At most `max_queued` jobs of all campaigns together are queued at a time."""

    def __init__(self, engine: Engine, max_queued: int) -> None:
        super().__init__(engine)
        self._max_queued = max_queued
        self._served: str | None = None
        """The campaign that had the last turn."""
        self._expanded: dict[str, tuple[CampaignSpec, list[View]]] = {}

    def tick(self) -> None:
        """Reads the jobs that have ended, plans the jobs of selected campaigns, and queues the next jobs of each."""
        while self._read_ended() == AT_ONCE:
            pass
        with self._read() as session:
            active = list(
                session.execute(
                    select(Campaign.id, Campaign.state)
                    .where(Campaign.state.in_((CampaignState.SELECTING, CampaignState.RUNNING)))
                    .order_by(Campaign.created_at, Campaign.id)
                )
            )
        self._expanded = {one: kept for one, kept in self._expanded.items() if one in {row.id for row in active}}
        for campaign_id, state in active:
            try:
                self._expand(campaign_id)
            except ValueError as error:
                self._fail(campaign_id, f"its request was valid when it was accepted, but is not any more: {error}")
                continue
            if state is CampaignState.SELECTING:
                self._plan(campaign_id)
            else:
                self._finish(campaign_id)
        # One job of each campaign in turn, so that a long campaign does not hold a short one up.
        waiting = list(self._expanded)
        turn = waiting.index(self._served) + 1 if self._served in waiting else 0
        waiting = waiting[turn:] + waiting[:turn]
        while waiting and self._queued() < self._max_queued:
            self._served = waiting.pop(0)
            if self._queue_one(self._served):
                waiting.append(self._served)

    def _queued(self) -> int:
        own = (Job.state == State.QUEUED, Job.campaign_id.is_not(None), not_held())
        with self._read() as session:
            return session.scalar(select(func.count()).select_from(Job).where(*own)) or 0

    def _queue_one(self, campaign_id: str) -> bool:
        """Queues the next job of a campaign. Returns whether there may be another one after it."""
        with self._write() as session:
            # held until the job is there, so that another supervisor does not queue the same one
            state = session.scalar(select(Campaign.state).where(Campaign.id == campaign_id).with_for_update())
            if state is CampaignState.SELECTING:
                return self._queue_selection(session, campaign_id)
            if state is CampaignState.RUNNING:
                return self._queue_attack(session, campaign_id)
            return False

    # Selection

    def _queue_selection(self, session: Session, campaign_id: str) -> bool:
        _, found = self._expanded[campaign_id]
        own = (Job.campaign_id == campaign_id, Job.kind == JobKind.SELECTION)
        begun = CHUNK * (session.scalar(select(func.count()).select_from(Job).where(*own)) or 0)
        chunk = found[begun : begun + CHUNK]
        if not chunk:
            return False
        asked = [{"number": view.number, "probe": view.probe.model_dump(mode="json")} for view in chunk]
        owner, demand = _sender(session, campaign_id)
        self._add_job(
            session, {"views": asked}, kind=JobKind.SELECTION, campaign_id=campaign_id, owner=owner, demand=demand
        )
        return begun + CHUNK < len(found)

    def _expand(self, campaign_id: str) -> None:
        if campaign_id not in self._expanded:
            with self._read() as session:
                spec = session.scalars(select(Campaign.spec).where(Campaign.id == campaign_id)).one()
            campaign = CampaignSpec.model_validate(spec)
            self._expanded[campaign_id] = campaign, views(campaign)

    def _fail(self, campaign_id: str, why: str) -> None:
        with self._write() as session:
            values = {"state": CampaignState.FAILED, "ended_at": self._now(session), "failure": why}
            active = (Campaign.id == campaign_id, Campaign.state.in_((CampaignState.SELECTING, CampaignState.RUNNING)))
            if session.scalar(update(Campaign).where(*active).values(values).returning(Campaign.id)) is None:
                return  # paused, or ended meanwhile
        log.warning("campaign failed", campaign=campaign_id, why=why)

    def _plan(self, campaign_id: str) -> None:
        """Chooses the views and plans the jobs, once all selection jobs have ended."""
        campaign, found = self._expanded[campaign_id]
        with self._read() as session:
            own = (Job.campaign_id == campaign_id, Job.kind == JobKind.SELECTION)
            asked = list(session.scalars(select(Job).where(*own).options(undefer(Job.result))))
            named = titles(session, meshes_of(found))
        if CHUNK * len(asked) < len(found) or not all(job.state.terminal for job in asked):
            return
        answers = _answers(asked)
        chosen = choose(found, answers, named)
        picked = [filled(view, answers[view.number].spec) for view in found if chosen[view.number].chosen]
        rows = [
            {
                "campaign_id": campaign_id,
                "number": number,
                "target": job.target,
                "attack": job.attack,
                "view": job.view,
                "right": chosen[job.view].right,
                "identity": answers[job.view].identity,
                "digest": digest(job.spec),
                "spec": job.spec.model_dump(mode="json"),
                "reused": False,
                "ended": False,
            }
            for number, job in enumerate(jobs(campaign, picked))
        ]
        with self._write() as session:
            values: dict[str, Any] = {
                "state": CampaignState.RUNNING,
                "selected_at": self._now(session),
                "views": [view.model_dump(mode="json") for view in chosen],
            }
            selecting = (Campaign.id == campaign_id, Campaign.state == CampaignState.SELECTING)
            if session.scalar(update(Campaign).where(*selecting).values(values).returning(Campaign.id)) is None:
                return  # paused or cancelled meanwhile, or planned by another supervisor
            if rows:
                session.execute(CampaignJob.__table__.insert(), rows)  # type: ignore[attr-defined]
        log.info("campaign planned", campaign=campaign_id, views=len(found), chosen=len(picked), jobs=len(rows))

    # Attacks

    def _queue_attack(self, session: Session, campaign_id: str) -> bool:
        campaign, _ = self._expanded[campaign_id]
        query = (
            select(CampaignJob)
            .where(CampaignJob.campaign_id == campaign_id, CampaignJob.job_id.is_(None), ~CampaignJob.ended)
            .order_by(CampaignJob.number)
            .limit(AT_ONCE)
            .options(undefer(CampaignJob.spec))
        )
        planned = session.scalars(query).all()
        owner, demand = _sender(session, campaign_id)
        for one in planned:
            earlier = _earlier(session, one, owner) if campaign.reuse else None
            if earlier is None:
                seed = int(one.spec["seed"])
                job = self._add_job(
                    session,
                    one.spec,
                    seed=seed,
                    digest=one.digest,
                    campaign_id=campaign_id,
                    owner=owner,
                    demand=demand,
                )
                one.job_id = job.id
                return True
            one.job_id, one.reused = earlier, True
        return False

    def _read_ended(self) -> int:
        """Makes cases of planned jobs that have ended. Returns the number of them."""
        query = (
            select(CampaignJob, Job)
            .join(Job, Job.id == CampaignJob.job_id)
            .where(~CampaignJob.ended, Job.state.in_([state for state in State if state.terminal]))
            .limit(AT_ONCE)
            .options(undefer(Job.result))
            .with_for_update(of=CampaignJob, skip_locked=True)
        )
        with self._write() as session:
            rows = session.execute(query).all()
            for planned, job in rows:
                planned.ended = True
                case = self._case(planned, job)
                planned.case = case.model_dump(mode="json")
        return len(rows)

    def _case(self, planned: CampaignJob, job: Job) -> Case:
        if job.state is not State.SUCCEEDED or job.result is None:
            return unfinished(planned.target, planned.attack, job.state.value, right=planned.right)
        try:
            result = Result.model_validate(job.result)
        except ValueError as error:
            log.warning("result of a campaign not readable", job=job.id, error=str(error))
            return unfinished(planned.target, planned.attack, "failed", right=planned.right)
        planned.curves = curves_record(curves_of(result))
        ended, began = job.succeeded_at, job.running_at
        seconds = None if ended is None or began is None else (ended - began).total_seconds()
        return case_of(result, planned.target, planned.attack, run_seconds=seconds, reused=planned.reused)

    def _finish(self, campaign_id: str) -> None:
        """Ends a campaign whose jobs have all ended."""
        left = select(CampaignJob.number).where(CampaignJob.campaign_id == campaign_id, ~CampaignJob.ended).exists()
        with self._write() as session:
            done = (Campaign.id == campaign_id, Campaign.state == CampaignState.RUNNING, ~left)
            values = {"state": CampaignState.FINISHED, "ended_at": self._now(session)}
            if session.scalar(update(Campaign).where(*done).values(values).returning(Campaign.id)) is not None:
                log.info("campaign finished", campaign=campaign_id)


def _answers(asked: Sequence[Job]) -> dict[int, FirstAnswer]:
    """The first answers that selection jobs found. The views of a job that failed are refused with its reason."""
    found: dict[int, FirstAnswer] = {}
    for job in asked:
        if job.state is State.SUCCEEDED and job.result is not None:
            answers = [FirstAnswer.model_validate(one) for one in job.result["answers"]]
        else:
            why = f"its first answer could not be found: {job.failure_kind or job.state.value}: {job.failure_detail}"
            answers = [FirstAnswer(view=one["number"], refused=why) for one in job.spec["views"]]
        found |= {answer.view: answer for answer in answers}
    return found


def _sender(session: Session, campaign_id: str) -> tuple[str, Demand]:
    """The owner of a campaign, and what its jobs ask of the queue."""
    found = session.execute(select(Campaign.owner, Campaign.demand).where(Campaign.id == campaign_id)).one()
    return found.owner, CAMPAIGNS if found.demand is None else Demand.of(found.demand)


def _earlier(session: Session, planned: CampaignJob, owner: str) -> str | None:
    """The id of the owner's earlier job with the same request, assets, weights, backend and versions that ran to its
    end.
    """
    ended = (Job.kind == JobKind.ATTACK, Job.state == State.SUCCEEDED)
    query = (
        select(Job)
        .where(Job.digest == planned.digest, Job.owner == owner, *ended)
        .order_by(Job.created_at)
        .options(undefer(Job.result))
    )
    for job in session.scalars(query):
        try:
            result = Result.model_validate(job.result)
        except ValueError:  # of a version with other fields
            continue
        if reusable(result, planned.digest, planned.identity):
            return job.id
    return None
