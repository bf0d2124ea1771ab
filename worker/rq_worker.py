"""The RQ worker: when a bell wakes it, it runs the job that the record names next, without forking.

The supervisor starts and restarts it with `python -m worker.rq_worker NAME`.
"""

import sys
import time
from itertools import count
from typing import Any

import rq
from redis import Redis
from redis.exceptions import RedisError
from rq import SimpleWorker
from rq.exceptions import StopRequested
from rq.job import Job as Bell
from rq.utils import now
from rq.worker_registration import clean_worker_registry

from services.jobs import watchdog
from services.jobs.child import ChildDied
from services.jobs.database import connect as connect_database
from services.jobs.placement import Priority
from services.jobs.queue import ANSWER_SECONDS, HEARTBEAT_SECONDS, Queue, connect, priority_of, queue_name
from services.jobs.record import Record
from services.logs import configure, logger
from services.settings import Settings
from worker.runner import RETRY_SECONDS, Runner

log = logger(__name__)


class JobWorker(SimpleWorker):  # type: ignore[misc]
    """RQ's worker, with heartbeats during jobs and a quick stop. It calls the runner, and nothing that a bell names:
    neither its function nor its callbacks, and it neither retries it nor sends webhooks.
    """

    max_connection_wait_time = 2.0
    log_job_description = False

    def __init__(self, runner: Runner, connection: Redis, **options: Any) -> None:
        self._queue = Queue(connection)
        names = [queue_name(priority) for priority in Priority]
        # RQ listens for worker_ttl - 15 seconds at a time and sends a heartbeat in between.
        ttl = 15 + HEARTBEAT_SECONDS
        super().__init__(names, connection=connection, worker_ttl=ttl, serializer="json", **options)
        self._runner = runner
        self._beaten = 0.0

    @property
    def connection_timeout(self) -> int:
        """Longest time in seconds for which the worker waits for Redis: less than a lease lasts. RQ's is 15."""
        return HEARTBEAT_SECONDS + ANSWER_SECONDS

    def heartbeat(self, timeout: int | None = None, pipeline: Any = None) -> None:
        """Sends RQ's heartbeat, and records that this worker is alive."""
        watchdog.alive()
        super().heartbeat(timeout, pipeline)
        self._queue.alive(self.name, self._runner.abilities)

    def register_death(self) -> None:
        """Records that this worker has ended."""
        watchdog.alive()
        super().register_death()
        self._queue.gone(self.name)

    def _beat(self) -> None:
        if time.monotonic() - self._beaten < HEARTBEAT_SECONDS:
            return
        self._beaten = time.monotonic()
        try:
            self.heartbeat()
        except RedisError as error:
            log.warning("Redis is out of reach, the job goes on", error=str(error))

    def execute_job(self, job: Bell, queue: rq.Queue) -> None:
        """Runs the next job of the priority of `queue`, if there is one. Whatever else the bell says is not read."""
        self._queue.answered(job.id)
        self._runner.run(priority_of(queue.name), self._beat)

    def run_maintenance_tasks(self) -> None:
        """Forgets workers that have died. RQ would also fail the bells they left, and call their callbacks."""
        for one in self.queues:
            clean_worker_registry(one)
        self.last_cleaned_at = now()

    def dequeue_job_and_maintain_ttl(self, timeout: int | None, max_idle_time: int | None = None) -> Any:
        """Answers a bell only when the job process is warm, so that no leased job waits for the process to start, and
        when the database and the data directory are there.
        """
        self._runner.ensure_ready()
        while not self._runner.usable() and not self._runner.stopping:
            self.heartbeat()
            time.sleep(RETRY_SECONDS)
        return super().dequeue_job_and_maintain_ttl(timeout, max_idle_time)

    def handle_warm_shutdown_request(self) -> None:
        """Handles SIGTERM and SIGINT: the running job is queued again, rather than waited for."""
        self._runner.request_stop()

    def subscribe(self) -> None:
        """Does nothing: RQ's commands through Redis are ignored, since jobs are stopped through the record."""

    def set_shutdown_requested_date(self) -> None:
        """Does nothing: RQ would call Redis within the signal handler, and fail to stop if Redis does not answer."""


def _work(runner: Runner, name: str, redis_url: str) -> None:
    """Runs jobs until the worker is stopped or Redis does not answer. The name must be new each time, since Redis may
    still know the worker from before.
    """
    watchdog.alive()
    try:
        JobWorker(runner, name=name, connection=connect(redis_url)).work(logging_level="WARNING")
    except RedisError as error:
        log.warning("Redis is out of reach", error=str(error))


def main() -> None:
    """Runs jobs until SIGTERM or SIGINT; exits with status 1 if the job process cannot be started."""
    configure("worker")
    values = Settings()
    name = sys.argv[1]
    runner = Runner(values, Record(connect_database(values)), name)
    assert values.redis_url is not None
    try:
        for life in count():
            runner.ensure_ready()  # before the worker registers as live
            _work(runner, f"{name}-{life}", values.redis_url)
            if runner.stopping:
                break
            time.sleep(RETRY_SECONDS)  # Redis is away; the job process stays warm meanwhile
    except StopRequested:  # between two lives
        pass
    except ChildDied:
        log.error("the job process could not be started")
        sys.exit(1)
    finally:
        runner.close()


if __name__ == "__main__":
    main()
