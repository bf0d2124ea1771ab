"""The order in which queued jobs are run: what the queue and the workers read of the record, and write about it."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import func, select, update
from sqlalchemy.orm import aliased

from services.jobs.attempts import Attempts
from services.jobs.models import Job, State
from services.jobs.placement import ANY_WORKER, Abilities, Needs, Priority
from services.jobs.transactions import not_held

_AT_ONCE = 500


@dataclass(frozen=True)
class Waiting:
    """A queued job: its id, the number of attempts it has had, and how many seconds ago its id was last put on the
    queue, by the database's clock; None if it was not yet.
    """

    job_id: str
    attempt: int
    sent_ago: float | None
    priority: Priority
    needs: Needs
    why: str | None
    """Why it waits, as the record says so far."""


class Turns(Attempts):
    """Queued jobs, whose turn it is, and why they wait."""

    def queued(self) -> list[Waiting]:
        """All queued jobs but those of paused campaigns, oldest first."""
        columns = select(Job.id, Job.attempt, Job.sent_at, Job.priority, Job.needs, Job.waiting)
        with self._read() as session:
            waiting = columns.where(Job.state == State.QUEUED, not_held())
            found = session.execute(waiting.order_by(Job.queued_at, Job.id)).all()
            now = self._now(session)
        return [
            Waiting(
                one.id,
                one.attempt,
                None if one.sent_at is None else (now - one.sent_at).total_seconds(),
                one.priority,
                Needs.read(one.needs),
                one.waiting,
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
            needs = session.scalars(select(func.coalesce(Job.needs, ANY_WORKER.text)).where(*queued).distinct()).all()
            mine = [text for text in needs if abilities.lacks(Needs.read(text)) is None]
            possible = (*queued, func.coalesce(Job.needs, ANY_WORKER.text).in_(mine))
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
        with self._write() as session:
            session.execute(
                update(Job)
                .where(Job.id == job_id, Job.attempt == attempt, Job.state == State.QUEUED)
                .values(sent_at=self._now(session))
            )
