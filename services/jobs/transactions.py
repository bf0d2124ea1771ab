"""Transactions on the record of jobs, and the only function that changes a job's state."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any
from uuid import uuid4

from sqlalchemy import Engine, or_, select, update
from sqlalchemy.orm import Session
from sqlalchemy.sql.elements import ColumnElement

from services.jobs.models import Campaign, CampaignState, Event, Job, JobKind, State
from services.pipeline.warning import JobWarning


class Transactions:
    """Sessions for reading and writing. `clock` returns the time of every write; tests replace it."""

    def __init__(self, engine: Engine, clock: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._reads = engine
        self._writes = engine.execution_options(writes=True)
        self._clock = clock

    @contextmanager
    def _read(self) -> Iterator[Session]:
        with Session(self._reads, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def _write(self) -> Iterator[Session]:
        with Session(self._writes, expire_on_commit=False) as session, session.begin():
            yield session

    def _add_job(
        self,
        session: Session,
        spec: dict[str, Any],
        *,
        seed: int = 0,
        kind: JobKind = JobKind.ATTACK,
        digest: str | None = None,
        campaign_id: str | None = None,
        warnings: Sequence[JobWarning] = (),
        checked: bool = True,
    ) -> Job:
        """Records a new queued job and its first event."""
        now = self._clock()
        job = Job(
            id=uuid4().hex,
            state=State.QUEUED,
            spec=spec,
            seed=seed,
            created_at=now,
            queued_at=now,
            kind=kind,
            digest=digest,
            campaign_id=campaign_id,
            attempt=0,
            lost=0,
            checked=checked,
            warnings=[one.model_dump(mode="json") for one in warnings],
            events=1,
        )
        session.add(job)
        session.flush()
        session.add(Event(job_id=job.id, number=1, kind="state", data=story(job), created_at=now))
        return job

    def _move(
        self, session: Session, job_id: str, to: State, where: Sequence[ColumnElement[bool]], **values: Any
    ) -> Job | None:
        """Changes a job's state if it meets the conditions `where`, and records the event; otherwise returns None."""
        now = self._clock()
        changed = (
            update(Job)
            .where(Job.id == job_id, *where)
            .values({"state": to, f"{to.value}_at": now, "events": Job.events + 1, **values})
            .returning(Job)
            .execution_options(synchronize_session=False, populate_existing=True)
        )
        job = session.scalars(changed).one_or_none()
        if job is not None:
            session.add(Event(job_id=job_id, number=job.events, kind="state", data=story(job), created_at=now))
        return job


def story(job: Job) -> dict[str, Any]:
    """The data of a state event: state and attempt; of a job that has ended the outcome, failure or bad fields."""
    data: dict[str, Any] = {"state": job.state.value, "attempt": job.attempt}
    if job.state == State.SUCCEEDED:
        data["outcome"] = job.outcome
    if job.state == State.REJECTED:
        data["errors"] = job.errors
    if job.state == State.FAILED:
        data["failure"] = {"kind": job.failure_kind, "detail": job.failure_detail}
    return data


def not_held() -> ColumnElement[bool]:
    """The condition that a queued job may run: it belongs to no campaign, or to one that is not paused."""
    paused = select(Campaign.id).where(Campaign.state == CampaignState.PAUSED)
    return or_(Job.campaign_id.is_(None), Job.campaign_id.not_in(paused))
