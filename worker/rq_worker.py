"""The RQ worker: takes job ids off the queue and runs them one by one. It forks nothing.

`python -m worker.rq_worker NAME`, started and restarted by the supervisor.
"""

import sys
import time
from typing import Any

from redis.exceptions import RedisError
from rq import SimpleWorker
from rq.job import Job as Message

from services.jobs import queue
from services.jobs.child import ChildDied
from services.jobs.database import connect as connect_database
from services.jobs.repository import Repository
from services.logs import configure, logger
from services.settings import settings
from worker.runner import Runner
from worker.task import bind

log = logger(__name__)


class JobWorker(SimpleWorker):  # type: ignore[misc]
    """RQ's in-process worker, with a heartbeat during jobs, a quick stop, and an eye on what messages ask for."""

    max_connection_wait_time = 2.0
    log_job_description = False

    def __init__(self, runner: Runner, **options: Any) -> None:
        # RQ listens 15 seconds less than the lifetime it is given, and says that it lives in between.
        super().__init__([queue.NAME], worker_ttl=15 + queue.HEARTBEAT_SECONDS, serializer="json", **options)
        self._runner = runner
        self._message: Message | None = None
        self._beaten = 0.0

    def run(self, job_id: str) -> None:
        """Run a job, saying to Redis now and then that this worker lives."""
        self._runner.run(job_id, self._beat)

    def heartbeat(self, timeout: int | None = None, pipeline: Any = None) -> None:
        """Say that this worker lives, for as long as it works on a queue."""
        super().heartbeat(timeout, pipeline)
        queue.Queue(self.connection).alive(self.name)

    def register_death(self) -> None:
        """Say that it does not any more."""
        super().register_death()
        queue.Queue(self.connection).gone(self.name)

    def _beat(self) -> None:
        now = time.monotonic()
        if self._message is None or now - self._beaten < queue.HEARTBEAT_SECONDS:
            return
        self._beaten = now
        try:
            self.maintain_heartbeats(self._message)
        except RedisError as error:
            log.warning("Redis is out of reach, the job goes on", error=str(error))

    def execute_job(self, job: Message, queue_: Any) -> None:
        """Run a message's job if it is a message of ours; a function named by anybody else is never called."""
        if job.func_name != queue.TASK:
            log.error("message refused", function=job.func_name)
            job.delete()
            return
        self._message = job
        try:
            super().execute_job(job, queue_)
        finally:
            self._message = None

    def dequeue_job_and_maintain_ttl(self, timeout: int | None, max_idle_time: int | None = None) -> Any:
        """Take a message only when the job process is warm: a job is never leased to wait for it."""
        self._runner.ensure_ready()
        return super().dequeue_job_and_maintain_ttl(timeout, max_idle_time)

    def handle_warm_shutdown_request(self) -> None:
        """On SIGTERM and SIGINT the running job is given back rather than waited for."""
        self._runner.request_stop()

    def subscribe(self) -> None:
        """Commands through Redis (stop a job, shut down) are not listened to: they come through the record."""

    def set_shutdown_requested_date(self) -> None:
        """RQ would tell Redis from within the signal handler, and stop stopping when Redis is away."""


def main() -> None:
    """Work until told to stop."""
    configure("worker")
    values = settings()
    name = sys.argv[1]
    runner = Runner(values, Repository(connect_database(values)), name)
    assert values.redis_url is not None
    try:
        runner.ensure_ready()  # it counts as a live worker only once it can run something
        worker = JobWorker(runner, name=name, connection=queue.connect(values.redis_url))
        bind(worker.run)
        worker.work(logging_level="WARNING")
    except ChildDied:
        log.error("the job process could not be started")
        sys.exit(1)
    finally:
        runner.close()


if __name__ == "__main__":
    main()
