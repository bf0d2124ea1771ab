"""The order in which queued jobs are run: what the queue and the workers read of the record, and write about it."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Select, func, select, tuple_, update
from sqlalchemy.orm import aliased

from services.jobs.attempts import Attempts
from services.jobs.models import Job, State
from services.jobs.placement import Abilities, Needs, Priority
from services.jobs.transactions import not_held
from services.jobs.utc_time import place

_AT_ONCE = 500


@dataclass(frozen=True)
class Waiting:
    """A queued job: its id, the number of attempts it has had, when it was submitted, and how many seconds ago its id
    was last put on the queue, by the database's clock; None if it was not yet.
    """

    job_id: str
    attempt: int
    created_at: datetime
    sent_ago: float | None
    priority: Priority
    needs: Needs
    why: str | None
    """Why it waits, as the record says so far."""


_COLUMNS = (Job.id, Job.attempt, Job.created_at, Job.sent_at, Job.priority, Job.needs, Job.waiting)
_QUEUED = select(*_COLUMNS).where(Job.state == State.QUEUED, not_held())


class Turns(Attempts):
    """Queued jobs, whose turn it is, and why they wait."""

    def queued(self, limit: int = _AT_ONCE, after: Waiting | None = None) -> list[Waiting]:
        """At most `limit` queued jobs but those of paused campaigns, oldest first: those that come after `after`."""
        query = _QUEUED.order_by(Job.created_at, Job.id).limit(limit)
        if after is not None:
            query = query.where(tuple_(Job.created_at, Job.id) > place((after.created_at, after.job_id)))
        return self._waiting(query)

    def unsent(self, limit: int) -> list[Waiting]:
        """At most `limit` queued jobs whose id was not put on the queue since they were queued."""
        return self._waiting(_QUEUED.where(Job.sent_at.is_(None)).limit(limit))

    def _waiting(self, query: Select[*tuple[Any, ...]]) -> list[Waiting]:
        with self._read() as session:
            found = session.execute(query).all()
            now = self._now(session) if found else None
        return [
            Waiting(
                job_id=one.id,
                attempt=one.attempt,
                created_at=one.created_at,
                sent_ago=None if one.sent_at is None or now is None else (now - one.sent_at).total_seconds(),
                priority=one.priority,
                needs=Needs.read(one.needs),
                why=one.waiting,
            )
            for one in found
        ]

    def turn(self, job_id: str, abilities: Abilities) -> str | None:
        """The queued job whose turn it is, of those with the priority of `job_id` that a worker with these abilities
        can run: the oldest one of the owner whose last job was started the longest ago; one whose attempt was lost or
        put off goes before new ones. None if there is none.

        Their needs may differ: a client that asks for another amount of memory in each job has no more turns by it.
        """
        other = aliased(Job)
        last = select(func.max(other.running_at)).where(other.owner == Job.owner, other.priority == Job.priority)
        with self._read() as session:
            priority = session.scalar(select(Job.priority).where(Job.id == job_id))
            queued = (Job.state == State.QUEUED, Job.priority == priority, not_held())
            needs = session.scalars(select(Job.needs).where(*queued).distinct()).all()
            mine = [text for text in needs if abilities.lacks(Needs.read(text)) is None]
            possible = (*queued, Job.needs.in_(mine))
            owners = select(Job.owner).where(*possible).group_by(Job.owner, Job.priority)
            owners = owners.order_by(last.scalar_subquery().nulls_first(), func.min(Job.queued_at)).limit(1)
            jobs = select(Job.id).where(*possible, Job.owner == owners.scalar_subquery())
            return session.scalar(jobs.order_by(Job.attempt == 0, Job.queued_at, Job.id).limit(1))

    def explain(self, job_ids: Sequence[str], why: str | None) -> None:
        """Records why these queued jobs wait; None: there is a worker that can run them."""
        with self._write() as session:
            for start in range(0, len(job_ids), _AT_ONCE):
                chunk = job_ids[start : start + _AT_ONCE]
                queued = (Job.id.in_(chunk), Job.state == State.QUEUED)
                session.execute(update(Job).where(*queued).values(waiting=why))

    def sent(self, job_id: str, attempt: int) -> None:
        """Records that a queued job's id was put on the queue now."""
        self.all_sent([(job_id, attempt)])

    def all_sent(self, jobs: Sequence[tuple[str, int]]) -> None:
        """Records that the ids of queued jobs, each with its number of attempts, were put on the queue now."""
        with self._write() as session:
            now = self._now(session)
            for job_id, attempt in sorted(jobs):  # in one order, so that two supervisors wait for each other in no ring
                queued = (Job.id == job_id, Job.attempt == attempt, Job.state == State.QUEUED)
                session.execute(update(Job).where(*queued).values(sent_at=now))
