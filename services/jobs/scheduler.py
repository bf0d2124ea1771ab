"""The order in which queued jobs are run, and why they wait. Redis only rings: what runs is decided here."""

from dataclasses import dataclass

from sqlalchemy import func, select, update
from sqlalchemy.orm import aliased

from services.jobs.database import Database
from services.jobs.models import Job, State, not_paused
from services.jobs.placement import Abilities, Needs, Priority, why_waiting
from services.jobs.queue import Queue

JOBS_PER_UPDATE = 500
"""Jobs that one statement names."""


@dataclass(frozen=True)
class Waiting:
    """Queued jobs of one priority that need the same, and for which the record has the same reason to wait."""

    priority: Priority
    needs: Needs
    why: str | None
    """Reason why no live worker can run them; None if one can."""


class Scheduler:
    """Decides which queued job runs next. A bell that is lost, or rings twice, changes no decision."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def next_job(self, priority: Priority, abilities: Abilities) -> str | None:
        """The id of the job that a worker with these abilities should run next; None if it can run none.

        Owners take turns, the least recently served first. Within an owner, jobs whose attempt was lost go first, then
        the oldest. Jobs of paused campaigns wait. This is advice: `Leases.lease` decides between two workers.

        Jobs of an owner may have different needs: a client that asks for another amount of memory in each job has no
        more turns by it.
        """
        earlier = aliased(Job)
        served = select(func.max(earlier.running_at)).where(earlier.owner == Job.owner, earlier.priority == priority)
        with self._database.read() as session:
            queued = (Job.state == State.QUEUED, Job.priority == priority, not_paused())
            needs = session.scalars(select(Job.needs).where(*queued).distinct()).all()
            runnable = (*queued, Job.needs.in_([text for text in needs if abilities.lacks(Needs.read(text)) is None]))
            owners = select(Job.owner).where(*runnable).group_by(Job.owner)
            least = owners.order_by(served.scalar_subquery().nulls_first(), func.min(Job.queued_at)).limit(1)
            jobs = select(Job.id).where(*runnable, Job.owner == session.scalar(least))
            return session.scalar(jobs.order_by(Job.attempt == 0, Job.queued_at, Job.id).limit(1))

    def waiting(self) -> list[Waiting]:
        """The kinds of queued jobs there are, but those of paused campaigns."""
        kinds = select(Job.priority, Job.needs, Job.waiting).where(Job.state == State.QUEUED, not_paused()).distinct()
        with self._database.read() as session:
            return [Waiting(row.priority, Needs.read(row.needs), row.waiting) for row in session.execute(kinds)]

    def explain(self, waiting: Waiting, why: str | None) -> None:
        """Records another reason why these jobs wait; None: there is a worker that can run them."""
        same = (Job.priority == waiting.priority, Job.needs == waiting.needs.text)
        jobs = select(Job.id).where(Job.state == State.QUEUED, *same, Job.waiting.is_not_distinct_from(waiting.why))
        with self._database.write() as session:
            # what another supervisor explains, or a worker leases, at this moment is left to them
            ids = session.scalars(jobs.with_for_update(skip_locked=True)).all()
            for start in range(0, len(ids), JOBS_PER_UPDATE):
                chunk = ids[start : start + JOBS_PER_UPDATE]
                session.execute(update(Job).where(Job.id.in_(chunk)).values(waiting=why))


def reconcile(scheduler: Scheduler, queue: Queue) -> None:
    """Records why queued jobs wait, and rings where a live worker can run one of them. Raises RedisError.

    There are then as many bells as workers: one that cannot run the job may answer first, and drops its bell.
    """
    workers = queue.workers()
    priorities: set[Priority] = set()
    for waiting in scheduler.waiting():
        why = why_waiting(waiting.needs, workers)
        if why != waiting.why:
            scheduler.explain(waiting, why)
        if why is None:
            priorities.add(waiting.priority)
    for priority in priorities:
        queue.ring(priority, len(workers) - queue.bells(priority))
