"""Campaigns in the record: what clients see and change, and the `Feeder`, which moves campaigns on.

A campaign first asks the networks for their first answers, in selection jobs of a few views each. Its jobs are then
planned, and queued a few at a time, so that single jobs never wait behind more than a few of them. The supervisor calls
`Feeder.tick` once a second. Everything is in the database, so that any supervisor goes on where another one stopped.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from math import degrees
from typing import Any
from uuid import uuid4

from sqlalchemy import ColumnElement, func, select, tuple_, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session, defer, undefer

from scene_attack.analysis.campaign_table import Case, CaseRow, Curves, mean_curves, table, time_left
from scene_attack.errors import QuotaExceeded
from scene_attack.logs import logger
from scene_attack.runs.campaign_plan import (
    CampaignResult,
    ChosenView,
    FirstAnswer,
    View,
    case_of,
    curves_of,
    curves_record,
    meshes_in,
    plan,
    reusable,
    unfinished,
    views,
)
from scene_attack.runs.campaign_spec import CampaignSpec, parse
from scene_attack.runs.check import most_views, uploads_in
from scene_attack.runs.result import Result
from scene_attack.runs.spec import digest
from scene_attack_service.jobs.database import Database, now
from scene_attack_service.jobs.jobs import Key, KeyReused, add_job
from scene_attack_service.jobs.leases import change_state
from scene_attack_service.jobs.models import (
    Campaign,
    CampaignJob,
    CampaignState,
    Job,
    JobKind,
    State,
    not_paused,
    place,
)
from scene_attack_service.jobs.queue import CAMPAIGNS, Demand
from scene_attack_service.jobs.uploads import check_held, refer_from_campaign, titles

ENDED_SECONDS = 60.0
"""Time after which an owner with too many campaigns may try again."""
_OPEN = [state for state in CampaignState if not state.terminal]
_ACTIVE = (CampaignState.SELECTING, CampaignState.RUNNING)


@dataclass(frozen=True)
class Progress:
    """Progress of a campaign: numbers of views with a first answer, and of jobs planned, ended and running."""

    views_answered: int
    jobs: int
    ended: int
    running: int


@dataclass(frozen=True)
class Counts:
    """The results of a campaign so far, in numbers."""

    outcomes: dict[str, int]
    successes: int
    reused: int
    seconds_left: float | None


class Campaigns:
    """The record of campaigns, as clients see and change it."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def submit(
        self,
        spec: CampaignSpec,
        key: str | None,
        owner: str = "",
        demand: Demand = CAMPAIGNS,
        owner_campaigns: int | None = None,
    ) -> Campaign:
        """Records a checked campaign; the supervisor queues its jobs. Returns it, or the first one of the key.

        Raises KeyReused if the key came with another request, QuotaExceeded if `owner_campaigns` of the owner have not
        ended, and InvalidRequest if a mesh of the request was deleted.
        """
        client_key = None if key is None else Key(key, digest(spec), owner)
        try:
            return self._create(spec, client_key, owner, demand, owner_campaigns)
        except IntegrityError:  # another process recorded the same key at the same moment
            return self._create(spec, client_key, owner, demand, owner_campaigns)

    def _create(
        self,
        spec: CampaignSpec,
        key: Key | None,
        owner: str,
        demand: Demand,
        owner_campaigns: int | None,
    ) -> Campaign:
        with self._database.write(durable=True) as session:
            if key is not None and (first := _first(session, key)) is not None:
                return first
            if owner_campaigns is not None:
                own = (Campaign.owner == owner, Campaign.state.in_(_OPEN))
                if (session.scalar(select(func.count()).select_from(Campaign).where(*own)) or 0) >= owner_campaigns:
                    detail = f"an owner may have {owner_campaigns:,} campaigns that have not ended"
                    raise QuotaExceeded(detail, ENDED_SECONDS)
            uploads = uploads_in(spec)
            check_held(session, uploads)
            campaign = Campaign(
                id=uuid4().hex,
                name=spec.name,
                state=CampaignState.SELECTING,
                spec=spec.model_dump(mode="json"),
                created_at=now(session),
                view_count=most_views(spec),
                key=None if key is None else key.stored,
                owner=owner,
                demand=asdict(demand),
                request_digest=digest(spec),
            )
            session.add(campaign)
            session.flush()
            refer_from_campaign(session, campaign.id, uploads)
            return campaign

    def of_key(self, key: Key) -> Campaign | None:
        """The campaign of the first request with this key, or None for a new key. Raises KeyReused."""
        with self._database.read() as session:
            return _first(session, key)

    def get(self, campaign_id: str, *, whole: bool = False) -> Campaign | None:
        """A campaign, or None if the id is unknown; `whole` reads its spec and its views, too."""
        options = [undefer(Campaign.spec), undefer(Campaign.views)] if whole else []
        with self._database.read() as session:
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
        with self._database.read() as session:
            return list(session.scalars(query))

    def pause(self, campaign_id: str) -> Campaign | None:
        """Holds the campaign's queued jobs back; running jobs go on to their end. Returns it, or None if unknown."""
        with self._database.write() as session:
            _change(session, campaign_id, _ACTIVE, state=CampaignState.PAUSED, paused_at=now(session))
            return session.get(Campaign, campaign_id)

    def resume(self, campaign_id: str) -> Campaign | None:
        """Lets the jobs of a paused campaign go on. Returns the campaign, or None if the id is unknown."""
        with self._database.write() as session:
            campaign = session.get(Campaign, campaign_id, with_for_update=True)
            if campaign is not None and campaign.state is CampaignState.PAUSED:
                campaign.state = CampaignState.SELECTING if campaign.selected_at is None else CampaignState.RUNNING
                campaign.paused_at = campaign.failure = None
            return campaign

    def cancel(self, campaign_id: str) -> Campaign | None:
        """Cancels the campaign: its queued jobs at once, its running jobs within a step; no more are queued.

        Returns the campaign, or None if the id is unknown.
        """
        with self._database.write() as session:
            ended = {"state": CampaignState.CANCELLED, "ended_at": now(session), "paused_at": None, "failure": None}
            if _change(session, campaign_id, _OPEN, **ended):
                own = (Job.campaign_id == campaign_id, Job.state.in_((State.QUEUED, State.RUNNING)))
                for job_id in session.scalars(select(Job.id).where(*own).order_by(Job.id).with_for_update()).all():
                    if change_state(session, job_id, State.CANCELLED, [Job.state == State.QUEUED]) is None:
                        change_state(session, job_id, State.CANCELLING, [Job.state == State.RUNNING])
            return session.get(Campaign, campaign_id)

    def progress(self, campaign_ids: Sequence[str]) -> dict[str, Progress]:
        """Returns the progress of each of these campaigns, by id."""
        own = Job.campaign_id.in_(campaign_ids)
        with self._database.read() as session:
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
            campaign_id: Progress(
                views_answered=views.get(campaign_id, 0),
                jobs=by_end.get((campaign_id, False), 0) + by_end.get((campaign_id, True), 0),
                ended=by_end.get((campaign_id, True), 0),
                running=busy.get(campaign_id, 0),
            )
            for campaign_id in campaign_ids
        }

    def cases(self, campaign_id: str) -> tuple[list[tuple[str, str]], list[Case]]:
        """(target, attack) of every planned job, and the cases of those that have ended, both in their order."""
        columns = select(CampaignJob.target, CampaignJob.attack, CampaignJob.ended, CampaignJob.case)
        own = columns.where(CampaignJob.campaign_id == campaign_id).order_by(CampaignJob.number)
        with self._database.read() as session:
            rows = session.execute(own).all()
        return [(row.target, row.attack) for row in rows], [Case.model_validate(row.case) for row in rows if row.ended]

    def counts(self, campaign_id: str, workers: int) -> Counts:
        """The results so far, and the time left with as many workers."""
        planned, cases = self.cases(campaign_id)
        return Counts(
            outcomes=dict(sorted(Counter(case.outcome for case in cases if case.outcome is not None).items())),
            successes=sum(case.success for case in cases),
            reused=sum(case.reused for case in cases),
            seconds_left=time_left(planned, cases, workers) if planned else None,
        )

    def result(self, campaign: Campaign, *, curves: bool = True) -> CampaignResult:
        """The table so far; the campaign must have been read whole. `curves` reads the curves of all traces, too."""
        planned, cases = self.cases(campaign.id)
        return CampaignResult(
            table=table(campaign.name, planned, cases),
            curves=mean_curves(self.curves(campaign.id)) if curves else [],
            views=[ChosenView.model_validate(view) for view in campaign.views or []],
        )

    def curves(self, campaign_id: str) -> list[tuple[str, str, Curves]]:
        """Target, attack and curves of every job that ran to its end on a view whose first answer was right."""
        own = (CampaignJob.campaign_id == campaign_id, CampaignJob.ended, CampaignJob.right)
        columns = select(CampaignJob.target, CampaignJob.attack, CampaignJob.curves).where(*own)
        with self._database.read() as session:
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
        with self._database.read() as session:
            return [(planned, job) for planned, job in session.execute(query)]

    def case_rows(self, campaign: Campaign) -> list[CaseRow]:
        """The jobs that have ended, with what they are about; the campaign must have been read whole."""
        chosen = (ChosenView.model_validate(view) for view in campaign.views or [])
        by_number = {view.number: view for view in chosen}
        seed = CampaignJob.spec["seed"].as_integer().label("seed")
        columns = select(CampaignJob.number, CampaignJob.view, CampaignJob.job_id, CampaignJob.case, seed)
        own = (CampaignJob.campaign_id == campaign.id, CampaignJob.ended)
        with self._database.read() as session:
            rows = session.execute(columns.where(*own).order_by(CampaignJob.number)).all()
        return [
            _case_row(row.number, row.job_id, row.seed, Case.model_validate(row.case), by_number.get(row.view))
            for row in rows
        ]

    def attributions(self, campaign_id: str, limit: int) -> list[tuple[str, str, dict[str, Any]]]:
        """Target, attack and attribution (scene_attack.analysis.records.Attribution) of the first `limit` jobs with a
        result, in their order.
        """
        attribution = Job.result["attribution"].as_json().label("attribution")
        query = (
            select(CampaignJob.target, CampaignJob.attack, attribution)
            .join(Job, Job.id == CampaignJob.job_id)
            .where(CampaignJob.campaign_id == campaign_id, CampaignJob.ended, Job.result.is_not(None))
            .order_by(CampaignJob.number)
            .limit(limit)
        )
        with self._database.read() as session:
            rows = session.execute(query).all()
        return [(row.target, row.attack, row.attribution) for row in rows]


def _change(
    session: Session, campaign_id: str, states: Sequence[CampaignState], *where: ColumnElement[bool], **values: Any
) -> bool:
    """Changes a campaign that is in one of the states and meets the conditions. Returns whether there is such a one."""
    meets = (Campaign.id == campaign_id, Campaign.state.in_(states), *where)
    return session.scalar(update(Campaign).where(*meets).values(**values).returning(Campaign.id)) is not None


def _first(session: Session, key: Key) -> Campaign | None:
    first = session.scalars(select(Campaign).where(Campaign.key == key.stored)).one_or_none()
    if first is not None and first.request_digest != key.digest:
        raise KeyReused
    return first


def _case_row(number: int, job_id: str | None, seed: int, case: Case, view: ChosenView | None) -> CaseRow:
    fields = {"target": case.target, "attack": case.attack, "seed": str(seed)}
    about = {
        "scene": view.scene if view else "",
        "azimuth": f"{degrees(view.azimuth):.0f}°" if view else "",
        "truth": ", ".join(view.truth) if view else "",
        "first answer": (view.label or "") if view else "",
    }
    return CaseRow(number, job_id, fields | about, case)


CHUNK = 16
"""Views of one selection job, which takes a few seconds."""
AT_ONCE = 50
"""Planned jobs of a campaign that one tick looks at: ended ones to read, or ones with an earlier result to take."""

log = logger(__name__)


class Feeder:
    """Moves campaigns on. At most `max_queued` jobs of all campaigns together are queued at a time."""

    def __init__(self, database: Database, max_queued: int) -> None:
        self._database = database
        self._max_queued = max_queued
        self._served: str | None = None
        """The campaign that had the last turn."""
        self._expanded: dict[str, tuple[CampaignSpec, list[View]]] = {}

    def tick(self) -> None:
        """Reads the jobs that have ended, plans the jobs of selected campaigns, and queues the next jobs of each."""
        while self._read_ended() == AT_ONCE:
            pass
        with self._database.read() as session:
            active = list(
                session.execute(
                    select(Campaign.id, Campaign.state)
                    .where(Campaign.state.in_(_ACTIVE))
                    .order_by(Campaign.created_at, Campaign.id)
                )
            )
        self._expanded = {
            campaign_id: kept
            for campaign_id, kept in self._expanded.items()
            if campaign_id in {row.id for row in active}
        }
        for campaign_id, state in active:
            try:
                self._expand(campaign_id)
            except ValueError as error:
                self._hold(campaign_id, f"its request was valid when it was accepted, but is not any more: {error}")
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
        own = (Job.state == State.QUEUED, Job.campaign_id.is_not(None), not_paused())
        with self._database.read() as session:
            return session.scalar(select(func.count()).select_from(Job).where(*own)) or 0

    def _queue_one(self, campaign_id: str) -> bool:
        """Queues the next job of a campaign. Returns whether there may be another one after it."""
        with self._database.write() as session:
            # held until the job is there, so that another supervisor does not queue the same one
            state = session.scalar(select(Campaign.state).where(Campaign.id == campaign_id).with_for_update())
            if state is CampaignState.SELECTING:
                return self._queue_selection(session, campaign_id)
            if state is CampaignState.RUNNING:
                return self._queue_attack(session, campaign_id)
            return False

    # Selection

    def _queue_selection(self, session: Session, campaign_id: str) -> bool:
        _, expanded = self._expanded[campaign_id]
        own = (Job.campaign_id == campaign_id, Job.kind == JobKind.SELECTION)
        begun = CHUNK * (session.scalar(select(func.count()).select_from(Job).where(*own)) or 0)
        chunk = expanded[begun : begun + CHUNK]
        if not chunk:
            return False
        asked = [{"number": view.number, "probe": view.probe.model_dump(mode="json")} for view in chunk]
        owner, demand = _sender(session, campaign_id)
        add_job(session, {"views": asked}, kind=JobKind.SELECTION, campaign_id=campaign_id, owner=owner, demand=demand)
        return begun + CHUNK < len(expanded)

    def _expand(self, campaign_id: str) -> None:
        if campaign_id not in self._expanded:
            with self._database.read() as session:
                spec = session.scalars(select(Campaign.spec).where(Campaign.id == campaign_id)).one()
            campaign = parse(spec)
            self._expanded[campaign_id] = campaign, views(campaign)

    def _hold(self, campaign_id: str, why: str) -> None:
        """Pauses a campaign that cannot go on as the service is now: a plug-in that it needs may be back tomorrow."""
        with self._database.write() as session:
            values = {"state": CampaignState.PAUSED, "paused_at": now(session), "failure": why}
            if not _change(session, campaign_id, _ACTIVE, **values):
                return  # paused, or ended meanwhile
        log.warning("campaign paused", campaign=campaign_id, why=why)

    def _plan(self, campaign_id: str) -> None:
        """Chooses the views and plans the jobs, once all selection jobs have ended."""
        campaign, expanded = self._expanded[campaign_id]
        with self._database.read() as session:
            own = (Job.campaign_id == campaign_id, Job.kind == JobKind.SELECTION)
            asked = list(session.scalars(select(Job).where(*own).options(undefer(Job.result))))
            named = titles(session, meshes_in(expanded))
        if CHUNK * len(asked) < len(expanded) or not all(job.state.terminal for job in asked):
            return
        answers = _answers(asked)
        chosen, planned = plan(campaign, expanded, answers, named)
        rows = [
            {
                "campaign_id": campaign_id,
                "number": number,
                "target": job.target,
                "attack": job.attack,
                "view": job.view,
                "right": job.right,
                "identity": job.identity,
                "digest": job.digest,
                "spec": job.spec.model_dump(mode="json"),
                "reused": False,
                "ended": False,
            }
            for number, job in enumerate(planned)
        ]
        with self._database.write() as session:
            values: dict[str, Any] = {
                "state": CampaignState.RUNNING,
                "selected_at": now(session),
                "views": [view.model_dump(mode="json") for view in chosen],
                "view_count": len(expanded),  # until now the largest number that there may be
            }
            if not _change(session, campaign_id, [CampaignState.SELECTING], **values):
                return  # paused or cancelled meanwhile, or planned by another supervisor
            if rows:
                session.execute(CampaignJob.__table__.insert(), rows)  # type: ignore[attr-defined]
        log.info(
            "campaign planned",
            campaign=campaign_id,
            views=len(expanded),
            chosen=sum(view.chosen for view in chosen),
            jobs=len(rows),
        )

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
        for planned_job in planned:
            earlier = _earlier(session, planned_job, owner) if campaign.reuse else None
            if earlier is None:
                seed = int(planned_job.spec["seed"])
                job = add_job(
                    session,
                    planned_job.spec,
                    seed=seed,
                    digest=planned_job.digest,
                    campaign_id=campaign_id,
                    owner=owner,
                    demand=demand,
                )
                planned_job.job_id = job.id
                return True
            planned_job.job_id, planned_job.reused = earlier, True
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
        with self._database.write() as session:
            rows = session.execute(query).all()
            for planned, job in rows:
                planned.ended = True
                case = self._case(planned, job)
                planned.case = case.model_dump(mode="json")
        return len(rows)

    def _case(self, planned: CampaignJob, job: Job) -> Case:
        if job.state is not State.SUCCEEDED or job.result is None:
            return unfinished(planned, job.state.value)
        try:
            result = Result.model_validate(job.result)
        except ValueError as error:
            log.warning("result of a campaign not readable", job=job.id, error=str(error))
            return unfinished(planned, "failed")
        planned.curves = curves_record(curves_of(result))
        ended, began = job.succeeded_at, job.running_at
        seconds = None if ended is None or began is None else (ended - began).total_seconds()
        return case_of(planned, result, run_seconds=seconds, reused=planned.reused)

    def _finish(self, campaign_id: str) -> None:
        """Ends a campaign whose jobs have all ended."""
        left = select(CampaignJob.number).where(CampaignJob.campaign_id == campaign_id, ~CampaignJob.ended).exists()
        with self._database.write() as session:
            values = {"state": CampaignState.FINISHED, "ended_at": now(session)}
            if _change(session, campaign_id, [CampaignState.RUNNING], ~left, **values):
                log.info("campaign finished", campaign=campaign_id)


def _answers(asked: Sequence[Job]) -> dict[int, FirstAnswer]:
    """The first answers that selection jobs found. The views of a job that failed are refused with its reason."""
    by_view: dict[int, FirstAnswer] = {}
    for job in asked:
        if job.state is State.SUCCEEDED and job.result is not None:
            answers = [FirstAnswer.model_validate(answer) for answer in job.result["answers"]]
        else:
            why = f"its first answer could not be found: {job.failure_kind or job.state.value}: {job.failure_detail}"
            answers = [FirstAnswer(view=view["number"], refused=why) for view in job.spec["views"]]
        by_view |= {answer.view: answer for answer in answers}
    return by_view


def _sender(session: Session, campaign_id: str) -> tuple[str, Demand]:
    """The owner of a campaign, and what its jobs ask of the queue."""
    row = session.execute(select(Campaign.owner, Campaign.demand).where(Campaign.id == campaign_id)).one()
    return row.owner, CAMPAIGNS if row.demand is None else Demand(**row.demand)


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
        if reusable(result, planned):
            return job.id
    return None
