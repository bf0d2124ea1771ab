"""All SQL of the service. Every change of a job goes through here, one transaction each.

An attempt is fenced: its writes carry its number and change nothing once the job has been taken back, finished or
given to a later attempt. A change of state and its event are one transaction, and so are a result and its artifacts.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import Enum
from typing import Any
from uuid import uuid4

from sqlalchemy import Engine, func, or_, select, text, tuple_, update
from sqlalchemy.orm import Session, undefer
from sqlalchemy.sql.elements import ColumnElement

from services.jobs.models import Artifact, Event, IdempotencyKey, Job, State
from services.pipeline.spec import JobSpec

ACTIVE = (State.RUNNING, State.CANCELLING)


class QueueFull(Exception):
    """As many jobs are queued as the settings allow."""


class KeyReused(Exception):
    """An idempotency key came back with a different request."""


@dataclass(frozen=True)
class Key:
    """A client's idempotency key and the digest of what it asked for."""

    value: str
    digest: str


@dataclass(frozen=True)
class Attempt:
    """The right to run a job and to write about it, until the lease lapses or the job moves on."""

    job_id: str
    number: int


@dataclass(frozen=True)
class Waiting:
    """A queued job: the attempts it has had, and when its id was last put on the queue."""

    job_id: str
    attempt: int
    sent_at: datetime | None


class Standing(Enum):
    """What the record says to a running attempt."""

    GO_ON = "go on"
    CANCEL = "cancel"
    LOST = "lost"


class Repository:
    """The record of jobs. `clock` gives the time of every write; tests set it."""

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

    def _move(
        self, session: Session, job_id: str, to: State, where: Sequence[ColumnElement[bool]], **values: Any
    ) -> Job | None:
        """Change a job's state where it still is as `where` says, and record the event. None if it was not."""
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
            session.add(Event(job_id=job_id, number=job.events, kind="state", data=_story(job), created_at=now))
        return job

    # What clients ask

    def ping(self) -> None:
        """Raise if the database does not answer."""
        with self._read() as session:
            session.execute(text("SELECT 1"))

    def create(
        self, spec: JobSpec, max_queued: int, key: Key | None, answer: Callable[[Job], dict[str, Any]]
    ) -> tuple[Job | None, dict[str, Any]]:
        """Record a new queued job. Returns it and its answer, or None and the first answer where the key was used.

        Raises QueueFull, and KeyReused where the key came with another request.
        """
        with self._write() as session:
            if key is not None and (first := _first_answer(session, key)) is not None:
                return None, first
            queued = session.scalar(select(func.count()).select_from(Job).where(Job.state == State.QUEUED)) or 0
            if queued >= max_queued:
                raise QueueFull
            now = self._clock()
            job = Job(
                id=uuid4().hex,
                state=State.QUEUED,
                spec=spec.model_dump(mode="json"),
                seed=spec.seed,
                created_at=now,
                queued_at=now,
                attempt=0,
                lost=0,
                events=1,
            )
            session.add(job)
            session.flush()
            session.add(Event(job_id=job.id, number=1, kind="state", data=_story(job), created_at=now))
            said = answer(job)
            if key is not None:
                session.add(
                    IdempotencyKey(key=key.value, digest=key.digest, job_id=job.id, answer=said, created_at=now)
                )
            return job, said

    def first_answer(self, key: Key) -> dict[str, Any] | None:
        """What the key's first request was answered; None for a new key. Raises KeyReused."""
        with self._read() as session:
            return _first_answer(session, key)

    def get(self, job_id: str, *, with_result: bool = False) -> Job | None:
        """A job; its result only if asked for, since it may be large."""
        with self._read() as session:
            return session.get(Job, job_id, options=[undefer(Job.result)] if with_result else [])

    def page(self, state: State | None, limit: int, before: tuple[datetime, str] | None) -> list[Job]:
        """Jobs from the newest, older than the job with (created_at, id) `before`."""
        query = select(Job).order_by(Job.created_at.desc(), Job.id.desc()).limit(limit)
        if state is not None:
            query = query.where(Job.state == state)
        if before is not None:
            query = query.where(tuple_(Job.created_at, Job.id) < tuple_(*before))
        with self._read() as session:
            return list(session.scalars(query))

    def request_cancel(self, job_id: str) -> Job | None:
        """Cancel a queued job at once, ask a running one to stop, leave any other as it is. None if unknown."""
        with self._write() as session:
            if self._move(session, job_id, State.CANCELLED, [Job.state == State.QUEUED]) is None:
                self._move(session, job_id, State.CANCELLING, [Job.state == State.RUNNING])
            return session.get(Job, job_id)

    def events(self, job_id: str, after: int, limit: int = 500) -> list[Event]:
        """Events of a job in order, those with a number above `after`."""
        query = select(Event).where(Event.job_id == job_id, Event.number > after).order_by(Event.number).limit(limit)
        with self._read() as session:
            return list(session.scalars(query))

    def artifacts(self, job_id: str) -> list[Artifact]:
        """Artifacts of a job by name."""
        with self._read() as session:
            return list(session.scalars(select(Artifact).where(Artifact.job_id == job_id).order_by(Artifact.name)))

    def artifact(self, job_id: str, name: str) -> Artifact | None:
        """One artifact of a job."""
        with self._read() as session:
            return session.get(Artifact, (job_id, name))

    # What the queue asks

    def queued(self) -> list[Waiting]:
        """All queued jobs, oldest first."""
        columns = select(Job.id, Job.attempt, Job.sent_at)
        with self._read() as session:
            found = session.execute(columns.where(Job.state == State.QUEUED).order_by(Job.queued_at, Job.id))
            return [Waiting(*row) for row in found]

    def sent(self, job_id: str, attempt: int) -> None:
        """Note that a queued job's id was put on the queue."""
        with self._write() as session:
            session.execute(
                update(Job)
                .where(Job.id == job_id, Job.attempt == attempt, Job.state == State.QUEUED)
                .values(sent_at=self._clock())
            )

    # What an attempt does

    def lease(self, job_id: str, owner: str, seconds: float) -> Attempt | None:
        """Take a queued job. None if it is not queued any more, as when its id was delivered twice."""
        with self._write() as session:
            job = self._move(
                session,
                job_id,
                State.RUNNING,
                [Job.state == State.QUEUED],
                attempt=Job.attempt + 1,
                lease_owner=owner,
                lease_until=self._clock() + timedelta(seconds=seconds),
                phase=None,
                step=None,
                steps=None,
            )
            return None if job is None else Attempt(job.id, job.attempt)

    def standing(self, attempt: Attempt) -> Standing:
        """Whether the attempt should go on."""
        with self._read() as session:
            found = session.execute(select(Job.state, Job.attempt).where(Job.id == attempt.job_id)).one_or_none()
        if found is None or found.attempt != attempt.number or found.state not in ACTIVE:
            return Standing.LOST
        return Standing.CANCEL if found.state == State.CANCELLING else Standing.GO_ON

    def renew(self, attempt: Attempt, seconds: float) -> Standing:
        """Extend the lease by so many seconds from now."""
        with self._write() as session:
            until = self._clock() + timedelta(seconds=seconds)
            session.execute(update(Job).where(*_fence(attempt)).values(lease_until=until))
        return self.standing(attempt)

    def progress(self, attempt: Attempt, phase: str, step: int, steps: int, rows: Sequence[dict[str, Any]]) -> bool:
        """Record how far the attempt is and the trace rows since its last report. False if it was fenced off."""
        with self._write() as session:
            changed = (
                update(Job)
                .where(*_fence(attempt))
                .values(phase=phase, step=step, steps=steps, events=Job.events + 1)
                .returning(Job.events)
            )
            number = session.scalar(changed)
            if number is None:
                return False
            data = {"phase": phase, "step": step, "steps": steps, "rows": list(rows)}
            session.add(
                Event(job_id=attempt.job_id, number=number, kind="progress", data=data, created_at=self._clock())
            )
            return True

    def succeed(
        self, attempt: Attempt, result: dict[str, Any], outcome: dict[str, Any], artifacts: Sequence[Artifact]
    ) -> bool:
        """Record the result; the artifacts' bytes must be in the store already. False if it was fenced off."""
        with self._write() as session:
            ended = self._end(session, attempt, State.SUCCEEDED, result=result, outcome=outcome)
            if ended:
                session.add_all(artifacts)
            return ended

    def fail(self, attempt: Attempt, kind: str, detail: str) -> bool:
        """End the job with a typed failure. False if the attempt was fenced off."""
        with self._write() as session:
            return self._end(session, attempt, State.FAILED, failure_kind=kind, failure_detail=detail)

    def cancelled(self, attempt: Attempt) -> bool:
        """Record that the attempt stopped as asked. False if it was fenced off."""
        with self._write() as session:
            return self._end(session, attempt, State.CANCELLED)

    def _end(self, session: Session, attempt: Attempt, to: State, **values: Any) -> bool:
        values |= {"lease_owner": None, "lease_until": None}
        return self._move(session, attempt.job_id, to, _fence(attempt)[1:], **values) is not None

    # What happens when an attempt cannot go on

    def give_back(self, attempt: Attempt) -> None:
        """Queue the job again, as when its worker is shut down; no attempt is counted as lost."""
        with self._write() as session:
            self._return(session, attempt, lost=0, max_attempts=1)

    def lose(self, attempt: Attempt, max_attempts: int) -> None:
        """The attempt's process died: queue the job again, or fail it when that happened too often."""
        with self._write() as session:
            self._return(session, attempt, lost=1, max_attempts=max_attempts)

    def take_back(self, max_attempts: int, owner: str | None = None) -> list[str]:
        """Lose all attempts whose lease has lapsed, or that an owner known to be dead still holds. Returns job ids."""
        gone = Job.lease_until < self._clock()
        if owner is not None:
            gone = or_(gone, Job.lease_owner == owner)
        with self._write() as session:
            found = session.execute(select(Job.id, Job.attempt).where(Job.state.in_(ACTIVE), gone)).all()
            for job_id, number in found:
                self._return(session, Attempt(job_id, number), lost=1, max_attempts=max_attempts)
        return [job_id for job_id, _ in found]

    def _return(self, session: Session, attempt: Attempt, *, lost: int, max_attempts: int) -> None:
        fence = _fence(attempt)[1:]
        free = {"lease_owner": None, "lease_until": None, "lost": Job.lost + lost}
        if self._move(session, attempt.job_id, State.CANCELLED, [*fence, Job.state == State.CANCELLING], **free):
            return
        if lost:
            too_often = [*fence, Job.lost + lost >= max_attempts]
            reason = {
                "failure_kind": "worker-lost",
                "failure_detail": f"its process died {max_attempts} times",
            }
            if self._move(session, attempt.job_id, State.FAILED, too_often, **free, **reason):
                return
        self._move(session, attempt.job_id, State.QUEUED, fence, **free, sent_at=None)


def _fence(attempt: Attempt) -> list[ColumnElement[bool]]:
    return [Job.id == attempt.job_id, Job.attempt == attempt.number, Job.state.in_(ACTIVE)]


def _first_answer(session: Session, key: Key) -> dict[str, Any] | None:
    first = session.get(IdempotencyKey, key.value)
    if first is None:
        return None
    if first.digest != key.digest:
        raise KeyReused
    return first.answer


def _story(job: Job) -> dict[str, Any]:
    """What a state event says."""
    told: dict[str, Any] = {"state": job.state.value, "attempt": job.attempt}
    if job.state == State.SUCCEEDED:
        told["outcome"] = job.outcome
    if job.state == State.FAILED:
        told["failure"] = {"kind": job.failure_kind, "detail": job.failure_detail}
    return told
