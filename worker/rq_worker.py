"""The RQ worker: it takes job ids off the queue and runs the jobs one by one, without forking.

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
from rq.job import Job as Message
from rq.utils import now
from rq.worker_registration import clean_worker_registry

from services.jobs import queue, watchdog
from services.jobs.child import ChildDied
from services.jobs.database import connect as connect_database
from services.jobs.placement import ANY_WORKER, Priority
from services.jobs.repository import Repository
from services.logs import configure, logger
from services.settings import Settings
from worker.runner import RETRY_SECONDS, Runner

log = logger(__name__)


class JobWorker(SimpleWorker):  # type: ignore[misc]
    """RQ's worker, with heartbeats during jobs and a quick stop. It calls the runner, and nothing that a message names:
    neither its function nor its callbacks, and it neither retries it nor sends webhooks.
    """

    max_connection_wait_time = 2.0
    log_job_description = False

    def __init__(self, runner: Runner, connection: Redis, **options: Any) -> None:
        self._messages = queue.Queue(connection)
        # Its queues are found at the first heartbeat. Redis is not asked before RQ has set how long answers may take.
        mine = [queue.queue_name(Priority.NORMAL, ANY_WORKER)]
        # RQ listens for worker_ttl - 15 seconds at a time and sends a heartbeat in between.
        ttl = 15 + queue.HEARTBEAT_SECONDS
        super().__init__(mine, connection=connection, worker_ttl=ttl, serializer="json", **options)
        self._runner = runner
        self._beaten = 0.0

    @property
    def connection_timeout(self) -> int:
        """Longest time in seconds for which the worker waits for Redis: less than a lease lasts. RQ's is 15."""
        return queue.HEARTBEAT_SECONDS + queue.ANSWER_SECONDS

    def heartbeat(self, timeout: int | None = None, pipeline: Any = None) -> None:
        """Sends RQ's heartbeat, and records that this worker is alive."""
        watchdog.alive()
        super().heartbeat(timeout, pipeline)
        self._messages.alive(self.name, self._runner.abilities)
        self._listen()

    def _listen(self) -> None:
        """Listens to all queues whose jobs this worker can run. There may be new ones since the last wait."""
        known = set(self.queue_names())
        mine = self._messages.for_worker(self._runner.abilities)
        if known != set(mine):
            self.queues = [rq.Queue(name, connection=self.connection, serializer="json") for name in mine]
            self._ordered_queues = list(self.queues)

    def reorder_queues(self, reference_queue: rq.Queue) -> None:
        """Puts the queue of the last message behind the others of its priority, so that they take turns."""

        def place(one: rq.Queue) -> tuple[int, bool]:
            return list(Priority).index(queue.priority_of(one.name)), one == reference_queue

        self._ordered_queues.sort(key=place)

    def register_death(self) -> None:
        """Records that this worker has ended."""
        watchdog.alive()
        super().register_death()
        self._messages.gone(self.name)

    def _beat(self) -> None:
        if time.monotonic() - self._beaten < queue.HEARTBEAT_SECONDS:
            return
        self._beaten = time.monotonic()
        try:
            self.heartbeat()
        except RedisError as error:
            log.warning("Redis is out of reach, the job goes on", error=str(error))

    def execute_job(self, job: Message, queue_: Any) -> None:  # noqa: ARG002 - RQ's signature
        """Runs the job whose id is in a message. A message that names anything else is refused."""
        self._messages.forget(job.id)  # what becomes of its job is in the record
        job_id = queue.job_id_of(job)
        if job_id is None:
            log.error("message refused: it is none of the service's", message=repr(job.id[:100]))
            return
        self._runner.run(job_id, self._beat)

    def run_maintenance_tasks(self) -> None:
        """Forgets workers that have died. RQ would also fail the messages they left, and call their callbacks."""
        for one in self.queues:
            clean_worker_registry(one)
        self.last_cleaned_at = now()

    def dequeue_job_and_maintain_ttl(self, timeout: int | None, max_idle_time: int | None = None) -> Any:
        """Takes a message only when the job process is warm, so that no leased job waits for the process to start, and
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
        JobWorker(runner, name=name, connection=queue.connect(redis_url)).work(logging_level="WARNING")
    except RedisError as error:
        log.warning("Redis is out of reach", error=str(error))


def main() -> None:
    """Runs jobs until SIGTERM or SIGINT; exits with status 1 if the job process cannot be started."""
    configure("worker")
    values = Settings()
    name = sys.argv[1]
    runner = Runner(values, Repository(connect_database(values)), name)
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
