"""Transactions on the record of jobs, and the only function that changes a job's state."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, datetime
from threading import Lock
from typing import Any
from uuid import uuid4

from sqlalchemy import Engine, func, or_, select, update
from sqlalchemy.orm import Session
from sqlalchemy.sql.elements import ColumnElement

from services.jobs import totals
from services.jobs.asset_uses import refer_from_job, titles, uploads_of
from services.jobs.listed import listed
from services.jobs.models import Campaign, CampaignState, Event, Job, JobKind, State
from services.jobs.placement import NO_DEMAND, Demand, targets_of
from services.pipeline.warning import JobWarning

READS_SQLITE = Lock()
"""SQLite hands Python's lock back and forth at every row. Threads that read at the same time spend more on that than on
reading: eight lists at once take a quarter less of the processor one after another.
"""


class Transactions:
    """Sessions for reading and writing. The time of every write is the database's; tests replace it by `clock`."""

    def __init__(self, engine: Engine, clock: Callable[[], datetime] | None = None) -> None:
        self._reads = engine
        is_sqlite = engine.dialect.name == "sqlite"
        self._reading: AbstractContextManager[Any] = READS_SQLITE if is_sqlite else nullcontext()
        self._writes = engine.execution_options(writes=True)
        self._lasting = engine.execution_options(writes=True, durable=True)
        self._clock = clock

    def _now(self, session: Session) -> datetime:
        """The time by the database's clock, which is one for all machines: theirs may differ by more than a lease."""
        if self._clock is not None:
            return self._clock()
        if session.get_bind().dialect.name == "sqlite":  # it is part of this process, and has this machine's clock
            return datetime.now(UTC)
        found: datetime = session.scalars(select(func.clock_timestamp())).one()
        return found.astimezone(UTC)

    def _lock(self, session: Session, job_id: str) -> None:
        """Holds a job's row until the transaction ends, so that what is read of it stays true until it is changed.

        SQLite needs no such lock: it has one writer at a time.
        """
        session.execute(select(Job.id).where(Job.id == job_id).with_for_update())

    @contextmanager
    def _read(self) -> Iterator[Session]:
        with self._reading, Session(self._reads, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def _write(self, *, durable: bool = False) -> Iterator[Session]:
        """A transaction. One that is `durable` is on the disk when it ends, also after a power cut."""
        with Session(self._lasting if durable else self._writes, expire_on_commit=False) as session, session.begin():
            session.connection()  # waits for the lock of SQLite, so that times that are read now are those of the write
            yield session
            totals.write(session)

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
        owner: str = "",
        demand: Demand = NO_DEMAND,
        retry_of: str | None = None,
    ) -> Job:
        """Records a new queued job and its first event."""
        now = self._now(session)
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
            owner=owner,
            priority=demand.priority,
            needs=demand.needs(targets_of(spec)).text,
            warnings=[one.model_dump(mode="json") for one in warnings],
            events=1,
            retry_of=retry_of,
            **(listed(spec, titles(session, uploads_of(spec))) if kind is not JobKind.SELECTION else {}),
        )
        session.add(job)
        session.flush()
        if kind is not JobKind.SELECTION:  # selections belong to a campaign, which refers to the meshes itself
            refer_from_job(session, job.id, uploads_of(spec))
        session.add(Event(job_id=job.id, number=1, kind="state", data=story(job), created_at=now))
        totals.count(session, "submitted", kind.value)
        return job

    def _move(
        self, session: Session, job_id: str, to: State, where: Sequence[ColumnElement[bool]], **values: Any
    ) -> Job | None:
        """Changes a job's state if it meets the conditions `where`, and records the event; otherwise returns None."""
        self._lock(session, job_id)
        now = self._now(session)
        ended = {"ended_at": now} if to.terminal else {}
        changed = (
            update(Job)
            .where(Job.id == job_id, *where)
            .values({"state": to, f"{to.value}_at": now, "events": Job.events + 1, **ended, **values})
            .returning(Job)
            .execution_options(synchronize_session=False, populate_existing=True)
        )
        job = session.scalars(changed).one_or_none()
        if job is not None:
            session.add(Event(job_id=job_id, number=job.events, kind="state", data=story(job), created_at=now))
            if to is State.RUNNING and job.queued_at is not None:
                totals.count_stage(session, "waiting", (now - job.queued_at).total_seconds())
            if to.terminal:
                totals.count_end(session, job, None if job.phase_at is None else (now - job.phase_at).total_seconds())
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
