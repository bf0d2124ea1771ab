"""Jobs in the record, as clients see and change them. What workers do with them is in `leases`.

Every change of a job is one transaction together with its event; a result and its artifacts are one, too.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from hashlib import sha256
from typing import Any
from uuid import uuid4

from sqlalchemy import ColumnElement, Select, delete, func, or_, select
from sqlalchemy.orm import Session, defer, undefer

from scene_attack.errors import InUse, QuotaExceeded
from scene_attack.runs.result import JobWarning
from scene_attack.runs.spec import JobSpec, RerenderingSpec, digest
from scene_attack_service.jobs.database import Database, now
from scene_attack_service.jobs.leases import change_state, count, lock, story
from scene_attack_service.jobs.models import (
    Artifact,
    Campaign,
    CampaignJob,
    Event,
    IdempotencyKey,
    Job,
    JobKind,
    State,
    listed,
)
from scene_attack_service.jobs.queue import NO_DEMAND, Demand, targets_of
from scene_attack_service.jobs.uploads import check_held, refer_from_job, titles, uploads_of

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
        """The key in the record, at most 255 characters. Keys of different owners never clash."""
        return sha256(f"{self.owner}\n{self.value}".encode()).hexdigest() if self.owner else self.value


@dataclass(frozen=True)
class News:
    """The next events of a job, in order, and whether nothing follows them: the job has ended, or was deleted."""

    events: list[Event]
    ended: bool


PAGE_ROWS = 500
"""Page size of queries whose result may be long."""
JOBS_PER_DELETION = 200
"""Jobs that one transaction deletes, and hashes that one query looks for."""
_AS_LISTED = (defer(Job.spec), defer(Job.result))


class Jobs:
    """Jobs as clients see them, submit, cancel and delete them."""

    def __init__(self, database: Database) -> None:
        self._database = database

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
        with self._database.write(durable=True) as session:
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
            check_held(session, uploads_of(request))
            job = add_job(
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
            reply = answer(job)
            if key is not None:
                values = {"key": key.stored, "digest": key.digest, "answer": reply, "created_at": job.created_at}
                session.add(IdempotencyKey(job_id=job.id, **values))
            return job, reply

    def first_answer(self, key: Key) -> dict[str, Any] | None:
        """The answer to the first request with this key, or None for a new key. Raises KeyReused."""
        with self._database.read() as session:
            return _first_answer(session, key)

    def line(self, job_id: str) -> Job | None:
        """An attack or re-rendering without its request and result, as lists show it; None if the id is unknown."""
        with self._database.read() as session:
            job = session.get(Job, job_id, options=_AS_LISTED)
            return None if job is None or job.kind is JobKind.SELECTION else job

    def get(self, job_id: str, *, with_result: bool = False) -> Job | None:
        """An attack or re-rendering, or None if the id is unknown. The result, which may be large, is read only if
        `with_result`.
        """
        with self._database.read() as session:
            job = session.get(Job, job_id, options=[undefer(Job.result)] if with_result else [])
            return None if job is None or job.kind is JobKind.SELECTION else job

    def work(self, job_id: str) -> Job | None:
        """A job of any kind, without its result, or None if the id is unknown."""
        with self._database.read() as session:
            return session.get(Job, job_id)

    def is_open(self, job_id: str) -> bool:
        """Whether there is a job with this id, of any kind, that has not ended."""
        with self._database.read() as session:
            state = session.scalar(select(Job.state).where(Job.id == job_id))
            return state is not None and not state.terminal

    def request_cancel(self, job_id: str) -> Job | None:
        """Cancels a queued job at once, and asks a running job to stop; leaves other jobs as they are.

        Returns the job, or None if the id is unknown.
        """
        with self._database.write() as session:
            if change_state(session, job_id, State.CANCELLED, [Job.state == State.QUEUED]) is None:
                change_state(session, job_id, State.CANCELLING, [Job.state == State.RUNNING])
            return session.get(Job, job_id)

    def news(self, seen: Mapping[str, int]) -> dict[str, News]:
        """Returns the news of each job since the event in `seen`, which has the number of the last one seen by job id.

        Jobs without news are left out.
        """
        news = {}
        with self._database.read() as session:
            for start in range(0, len(seen), PAGE_ROWS):
                ids = list(seen)[start : start + PAGE_ROWS]
                rows = session.execute(select(Job.id, Job.state, Job.events).where(Job.id.in_(ids)))
                standing = {row.id: row for row in rows}
                for job_id in ids:
                    now = standing.get(job_id)
                    if now is None:
                        news[job_id] = News([], True)
                    elif now.events > seen[job_id]:
                        events = list(session.scalars(_events(job_id, seen[job_id], PAGE_ROWS)))
                        last = events[-1].number if events else now.events  # none: it was deleted meanwhile
                        news[job_id] = News(events, now.state.terminal and last >= now.events)
        return news

    def events(self, job_id: str, after: int, limit: int = PAGE_ROWS) -> list[Event]:
        """At most `limit` events of a job with a number above `after`, in order."""
        with self._database.read() as session:
            return list(session.scalars(_events(job_id, after, limit)))

    def artifacts(self, job_id: str) -> list[Artifact]:
        """The artifacts of a job, sorted by name."""
        with self._database.read() as session:
            return list(session.scalars(select(Artifact).where(Artifact.job_id == job_id).order_by(Artifact.name)))

    def artifact(self, job_id: str, name: str) -> Artifact | None:
        """An artifact of a job, or None if there is none of this name."""
        with self._database.read() as session:
            return session.get(Artifact, (job_id, name))

    def delete(self, job_id: str) -> list[str]:
        """Deletes a job and returns the hashes of its files. Does nothing if there is no such job.

        Raises InUse if the job has not ended or a campaign refers to it.
        """
        with self._database.write() as session:
            lock(session, job_id)
            row = session.execute(select(Job.state).where(Job.id == job_id)).one_or_none()
            if row is None:
                return []
            if not row.state.terminal:
                raise InUse(f"the job is {row.state.value}; cancel it, and delete it once it has ended")
            campaign = session.scalar(select(CampaignJob.campaign_id).where(CampaignJob.job_id == job_id).limit(1))
            if campaign is not None:
                raise InUse(f"the campaign {campaign} refers to the job")
            return self._delete(session, [job_id])

    def expire(self, days: float) -> list[str]:
        """Deletes campaigns that ended more than `days` ago, and at most `JOBS_PER_DELETION` jobs that did and to which
        no campaign refers. Returns the hashes of their files.
        """
        with self._database.write() as session:
            before = now(session) - timedelta(days=days)
            session.execute(delete(Campaign).where(Campaign.ended_at < before))
            ended = func.coalesce(Job.succeeded_at, Job.failed_at, Job.rejected_at, Job.cancelled_at)
            over = Job.state.in_([state for state in State if state.terminal])
            old = select(Job.id).where(over, ended < before, _of_no_campaign()).order_by(Job.id)
            old = old.limit(JOBS_PER_DELETION)
            return self._delete(session, session.scalars(old.with_for_update()).all())

    def unnamed(self, hashes: Collection[str]) -> set[str]:
        """Returns those of the hashes that no job's artifact has."""
        left, asked = set(hashes), sorted(hashes)
        with self._database.read() as session:
            for start in range(0, len(asked), JOBS_PER_DELETION):
                some = asked[start : start + JOBS_PER_DELETION]
                left -= set(session.scalars(select(Artifact.sha256).where(Artifact.sha256.in_(some))))
        return left

    def _delete(self, session: Session, ids: Sequence[str]) -> list[str]:
        hashes = session.scalars(select(Artifact.sha256).where(Artifact.job_id.in_(ids)).distinct()).all()
        session.execute(delete(Job).where(Job.id.in_(ids)))  # the rest of a job's rows go with it
        return list(hashes)


def add_job(
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
    at = now(session)
    job = Job(
        id=uuid4().hex,
        state=State.QUEUED,
        spec=spec,
        seed=seed,
        created_at=at,
        queued_at=at,
        kind=kind,
        digest=digest,
        campaign_id=campaign_id,
        attempt=0,
        lost=0,
        checked=checked,
        owner=owner,
        priority=demand.priority,
        needs=demand.needs(targets_of(spec)).text,
        warnings=[warning.model_dump(mode="json") for warning in warnings],
        events=1,
        retry_of=retry_of,
        **(listed(spec, titles(session, uploads_of(spec))) if kind is not JobKind.SELECTION else {}),
    )
    session.add(job)
    session.flush()
    if kind is not JobKind.SELECTION:  # selections belong to a campaign, which refers to the meshes itself
        refer_from_job(session, job.id, uploads_of(spec))
    session.add(Event(job_id=job.id, number=1, kind="state", data=story(job), created_at=at))
    count(session, "submitted", kind.value)
    return job


def _events(job_id: str, after: int, limit: int) -> Select[Event]:
    return select(Event).where(Event.job_id == job_id, Event.number > after).order_by(Event.number).limit(limit)


def _first_answer(session: Session, key: Key) -> dict[str, Any] | None:
    first = session.get(IdempotencyKey, key.stored)
    if first is None:
        return None
    if first.digest != key.digest:
        raise KeyReused
    return first.answer


def _of_no_campaign() -> ColumnElement[bool]:
    named = select(CampaignJob.job_id).where(CampaignJob.job_id == Job.id).exists()
    there = select(Campaign.id).where(Campaign.id == Job.campaign_id).exists()
    return ~named & or_(Job.campaign_id.is_(None), ~there)
