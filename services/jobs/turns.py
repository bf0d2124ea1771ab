"""The order in which queued jobs are run: what the queue and the workers read of the record, and write about it."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import func, select, update
from sqlalchemy.orm import aliased, defer

from services.jobs.attempts import Attempts
from services.jobs.models import Job, State
from services.jobs.placement import Needs, Priority
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

    def turn(self, job_id: str) -> str:
        """The queued job whose turn it is, of those with the priority and the needs of `job_id`: the oldest one of the
        owner whose last job was started the longest ago; one whose attempt was lost or put off goes before new ones.
        If none is queued, `job_id` itself.
        """
        other = aliased(Job)
        last = select(func.max(other.running_at)).where(other.owner == Job.owner, other.priority == Job.priority)
        with self._read() as session:
            asked = session.get(Job, job_id, options=[defer(Job.spec)])
            if asked is None:
                return job_id
            needs = Job.needs.is_(None) if asked.needs is None else Job.needs == asked.needs
            alike = (Job.state == State.QUEUED, Job.priority == asked.priority, needs, not_held())
            owners = select(Job.owner).where(*alike).group_by(Job.owner, Job.priority)
            owners = owners.order_by(last.scalar_subquery().nulls_first(), func.min(Job.queued_at)).limit(1)
            mine = select(Job.id).where(*alike, Job.owner == owners.scalar_subquery())
            return session.scalar(mine.order_by(Job.attempt == 0, Job.queued_at, Job.id).limit(1)) or job_id

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
