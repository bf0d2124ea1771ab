"""Keeps queue and record together: rings for queued jobs whose bell was lost, and records why jobs wait."""

from services.jobs.placement import Priority, why_waiting
from services.jobs.queue import Queue
from services.jobs.record import Record


def reconcile(record: Record, queue: Queue) -> None:
    """Records why queued jobs wait, and rings where a live worker can run one of them. Raises RedisError.

    There are then as many bells as workers: one that cannot run the job may answer first, and drops its bell.
    """
    workers = queue.workers()
    wanted: set[Priority] = set()
    for waiting in record.scheduler.waiting():
        why = why_waiting(waiting.needs, workers)
        if why != waiting.why:
            record.scheduler.explain(waiting, why)
        if why is None:
            wanted.add(waiting.priority)
    for priority in wanted:
        queue.ring(priority, len(workers) - queue.bells(priority))
