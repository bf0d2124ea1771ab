"""Keeps queue and record together: sends queued jobs that have no message, and records why jobs wait.

Each look reads few jobs, however many are queued: those that were never sent, and the next part of all the others in
turn, whose messages Redis may have lost.
"""

from collections.abc import Iterable, Sequence

from services.jobs.placement import Abilities, why_waiting
from services.jobs.queue import Queue, message_id
from services.jobs.repository import Repository
from services.jobs.turns import Waiting

AT_ONCE = 200
"""Jobs that were never sent, and others, that one look reads at most: of 10,000 each is looked at every 50 looks."""
SETTLE_SECONDS = 5.0
"""Age below which a missing message is not sent again: a worker may have taken it and not leased its job yet."""


class Reconciler:
    """Looks at the queued jobs in turn."""

    def __init__(self, repository: Repository, queue: Queue) -> None:
        self._repository = repository
        self._queue = queue
        self._last: Waiting | None = None

    def look(self) -> int:
        """Sends those of some queued jobs that have no message. Returns how many were sent. Raises RedisError."""
        others = self._repository.queued(AT_ONCE, self._last)
        self._last = others[-1] if len(others) == AT_ONCE else None
        found = {job.job_id: job for job in [*self._repository.unsent(AT_ONCE), *others]}
        if not found:
            return 0
        self._explain(found.values(), self._queue.workers())
        doubtful = [job for job in found.values() if not _settling(job)]
        waiting = self._queue.waiting() if doubtful else set()
        missing = [job for job in doubtful if message_id(job.job_id, job.attempt) not in waiting]
        for job in missing:
            if job.sent_ago is not None:
                self._queue.forget(message_id(job.job_id, job.attempt))
            self._queue.send(job.job_id, job.attempt, job.priority, job.needs)
        # also those whose sender died before it had recorded that they were sent
        sent = {job.job_id: job.attempt for job in [*missing, *(job for job in doubtful if job.sent_ago is None)]}
        if sent:
            self._repository.all_sent(list(sent.items()))
        return len(missing)

    def _explain(self, jobs: Iterable[Waiting], workers: Sequence[Abilities]) -> None:
        """Records of jobs that no live worker can run why they wait."""
        jobs = list(jobs)
        reasons = {needs: why_waiting(needs, workers) for needs in {job.needs for job in jobs}}
        changed: dict[str | None, list[str]] = {}
        for job in jobs:
            if reasons[job.needs] != job.why:
                changed.setdefault(reasons[job.needs], []).append(job.job_id)
        for why, job_ids in changed.items():
            self._repository.explain(job_ids, why)


def _settling(job: Waiting) -> bool:
    # a time in the future is that of a clock that was put back since
    return job.sent_ago is not None and 0 <= job.sent_ago < SETTLE_SECONDS
