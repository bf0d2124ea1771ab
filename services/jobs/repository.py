"""The record of jobs. All SQL of the service is in this module, `attempts`, `turns` and `transactions`.

Every change of a job is one transaction together with its event; a result and its artifacts are one, too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from typing import Any

from sqlalchemy import Select, func, select, text
from sqlalchemy.orm import Session, defer, undefer

from services.errors import QuotaExceeded
from services.jobs.asset_uses import check_held, uploads_of
from services.jobs.models import Artifact, Event, IdempotencyKey, Job, JobKind, State
from services.jobs.placement import NO_DEMAND, Demand
from services.jobs.turns import Turns
from services.pipeline.names_known import check_meshes
from services.pipeline.rerendering_spec import RerenderingSpec
from services.pipeline.spec import JobSpec, digest
from services.pipeline.warning import JobWarning

QUEUED_SECONDS = 30.0
"""Time after which an owner with too many queued jobs may try again."""


class QueueFull(Exception):
    """The number of queued jobs has reached the limit of the settings."""


class KeyReused(Exception):
    """An idempotency key was used before with a different request."""


@dataclass(frozen=True)
class Key:
    """A client's idempotency key, the digest of the request that it came with, and the client's owner."""

    value: str
    digest: str
    owner: str = ""

    @property
    def stored(self) -> str:
        """What the record has of it, at most 255 characters: each owner has keys of its own."""
        return sha256(f"{self.owner}\n{self.value}".encode()).hexdigest() if self.owner else self.value


@dataclass(frozen=True)
class News:
    """The next events of a job, in order, and whether nothing follows them: the job has ended, or was deleted."""

    events: list[Event]
    ended: bool


_AT_ONCE = 500
"""Rows that one query reads at most of what may be long."""
_AS_LISTED = (defer(Job.spec), defer(Job.result))


class Repository(Turns):
    """The record of jobs: what clients do with it, and from `Turns` and `Attempts` what the queue and workers do."""

    # Operations of clients

    def ping(self) -> None:
        """Raises SQLAlchemyError if the database does not answer."""
        with self._read() as session:
            session.execute(text("SELECT version_num FROM alembic_version"))  # SQLite reads the file for this

    def create(
        self,
        spec: JobSpec | RerenderingSpec,
        max_queued: int,
        key: Key | None,
        answer: Callable[[Job], dict[str, Any]],
        warnings: Sequence[JobWarning] = (),
        *,
        checked: bool = True,
        owner: str = "",
        owner_queued: int | None = None,
        demand: Demand = NO_DEMAND,
        retry_of: str | None = None,
        file: Artifact | None = None,
    ) -> tuple[Job | None, dict[str, Any]]:
        """Records a new queued job. Returns it and `answer(job)`, or None and the key's first answer if it was used.

        It begins with `file`, whose bytes are in the store: the checkpoint of another job, or an image to re-render.

        Raises QueueFull if `max_queued` jobs are queued, QuotaExceeded if the owner has `owner_queued` of them,
        KeyReused if the key came with another request, and InvalidRequest if a mesh of the request was deleted.
        """
        with self._write(durable=True) as session:
            if key is not None and (first := _first_answer(session, key)) is not None:
                return None, first
            single = (Job.state == State.QUEUED, Job.campaign_id.is_(None))  # campaigns have a limit of their own
            if (session.scalar(select(func.count()).select_from(Job).where(*single)) or 0) >= max_queued:
                raise QueueFull
            if owner_queued is not None:
                own = select(func.count()).select_from(Job).where(*single, Job.owner == owner)
                if (session.scalar(own) or 0) >= owner_queued:
                    raise QuotaExceeded(f"an owner may have {owner_queued:,} jobs queued", QUEUED_SECONDS)
            request = spec.model_dump(mode="json")
            check_held(session, uploads_of(request), partial(check_meshes, spec.scene))
            job = self._add_job(
                session,
                request,
                seed=spec.seed if isinstance(spec, JobSpec) else 0,
                kind=JobKind.ATTACK if isinstance(spec, JobSpec) else JobKind.RERENDERING,
                digest=digest(spec),
                warnings=warnings,
                checked=checked,
                owner=owner,
                demand=demand,
                retry_of=retry_of,
            )
            if file is not None:
                about = {"name": file.name, "sha256": file.sha256, "size": file.size, "media_type": file.media_type}
                session.add(Artifact(job_id=job.id, **about))
            said = answer(job)
            if key is not None:
                values = {"key": key.stored, "digest": key.digest, "answer": said, "created_at": job.created_at}
                session.add(IdempotencyKey(job_id=job.id, **values))
            return job, said

    def first_answer(self, key: Key) -> dict[str, Any] | None:
        """The answer to the first request with this key, or None for a new key. Raises KeyReused."""
        with self._read() as session:
            return _first_answer(session, key)

    def line(self, job_id: str) -> Job | None:
        """An attack or re-rendering without its request and result, as lists show it; None if the id is unknown."""
        with self._read() as session:
            job = session.get(Job, job_id, options=_AS_LISTED)
            return None if job is None or job.kind is JobKind.SELECTION else job

    def get(self, job_id: str, *, with_result: bool = False) -> Job | None:
        """An attack or re-rendering, or None if the id is unknown. The result, which may be large, is read only if
        `with_result`.
        """
        with self._read() as session:
            job = session.get(Job, job_id, options=[undefer(Job.result)] if with_result else [])
            return None if job is None or job.kind is JobKind.SELECTION else job

    def work(self, job_id: str) -> Job | None:
        """A job of any kind, without its result, or None if the id is unknown."""
        with self._read() as session:
            return session.get(Job, job_id)

    def request_cancel(self, job_id: str) -> Job | None:
        """Cancels a queued job at once, and asks a running job to stop; leaves other jobs as they are.

        Returns the job, or None if the id is unknown.
        """
        with self._write() as session:
            if self._move(session, job_id, State.CANCELLED, [Job.state == State.QUEUED]) is None:
                self._move(session, job_id, State.CANCELLING, [Job.state == State.RUNNING])
            return session.get(Job, job_id)

    def news(self, seen: Mapping[str, int]) -> dict[str, News]:
        """Of each job by its id and the number of its last event that was seen: what is new. Without the jobs of which
        there is nothing new.
        """
        found = {}
        with self._read() as session:
            for start in range(0, len(seen), _AT_ONCE):
                ids = list(seen)[start : start + _AT_ONCE]
                rows = session.execute(select(Job.id, Job.state, Job.events).where(Job.id.in_(ids)))
                standing = {row.id: row for row in rows}
                for job_id in ids:
                    now = standing.get(job_id)
                    if now is None:
                        found[job_id] = News([], True)
                    elif now.events > seen[job_id]:
                        events = list(session.scalars(_events(job_id, seen[job_id], _AT_ONCE)))
                        last = events[-1].number if events else now.events  # none: it was deleted meanwhile
                        found[job_id] = News(events, now.state.terminal and last >= now.events)
        return found

    def events(self, job_id: str, after: int, limit: int = _AT_ONCE) -> list[Event]:
        """At most `limit` events of a job with a number above `after`, in order."""
        with self._read() as session:
            return list(session.scalars(_events(job_id, after, limit)))

    def artifacts(self, job_id: str) -> list[Artifact]:
        """The artifacts of a job, sorted by name."""
        with self._read() as session:
            return list(session.scalars(select(Artifact).where(Artifact.job_id == job_id).order_by(Artifact.name)))

    def artifact(self, job_id: str, name: str) -> Artifact | None:
        """An artifact of a job, or None if there is none of this name."""
        with self._read() as session:
            return session.get(Artifact, (job_id, name))


def _events(job_id: str, after: int, limit: int) -> Select[Event]:
    return select(Event).where(Event.job_id == job_id, Event.number > after).order_by(Event.number).limit(limit)


def _first_answer(session: Session, key: Key) -> dict[str, Any] | None:
    first = session.get(IdempotencyKey, key.stored)
    if first is None:
        return None
    if first.digest != key.digest:
        raise KeyReused
    return first.answer
