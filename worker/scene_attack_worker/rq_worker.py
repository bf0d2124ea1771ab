"""A worker: when a bell wakes it, it runs the job that the record names next, and watches its process until it ends.

The supervisor starts and restarts it with `python -m scene_attack_worker.rq_worker NAME`. It loads neither torch nor
OpenGL, so it survives a crash of the warm job process (`scene_attack_worker.job_process`) and can report it.
"""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
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
from sqlalchemy.exc import SQLAlchemyError

from scene_attack.client.states import Priority
from scene_attack.logs import configure, logger
from scene_attack_service.jobs import processes
from scene_attack_service.jobs.database import connect as connect_database
from scene_attack_service.jobs.files import ArtifactStore, Storage
from scene_attack_service.jobs.leases import Attempt, Standing
from scene_attack_service.jobs.processes import Child, ChildDied, OutOfMemory
from scene_attack_service.jobs.queue import (
    ANSWER_SECONDS,
    HEARTBEAT_SECONDS,
    NOTHING,
    Abilities,
    Queue,
    connect,
    priority_of,
    queue_name,
)
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings

START_SECONDS = 600.0
"""Longest time that a job process may take to load: two minutes on a machine that others keep busy. One that hangs is
noticed earlier.
"""
POLL_SECONDS = 0.1
"""Longest time between two checks whether the worker should stop."""
STOP_SECONDS = 30.0
"""Time after which a job process is killed if it still runs a job that was cancelled or taken back. It renders the best
that the attack has found, which takes seconds."""
RETRY_SECONDS = 1.0
"""Time between two tries to reach what is away."""
TURNS = 3
"""Tries to lease the next job: another worker may be quicker."""
MAX_JOBS = 200
"""Number of jobs after which a job process is replaced."""
MAX_GROWTH = 2 * 2**30
"""Growth of a job process's resident memory, in bytes, after which the process is replaced."""

log = logger(__name__)


class Runner:
    """Runs jobs for the worker `owner`, under whose name the jobs are leased."""

    def __init__(self, settings: Settings, record: Record, owner: str) -> None:
        self._settings = settings
        self._record = record
        self._owner = owner
        self._storage = Storage(settings.data_dir, ArtifactStore(settings.files))
        self._child: Child | None = None
        self._jobs = 0
        self._memory = 0
        self.stopping = False
        """Whether the worker was asked to stop."""
        self.abilities = NOTHING
        """Abilities of the job process, known once it has been ready."""

    def request_stop(self) -> None:
        """Makes `run` queue a running job again and return. May be called in a signal handler."""
        self.stopping = True

    def close(self) -> None:
        """Kills the job process."""
        if self._child is not None:
            self._child.kill()
            self._child = None

    def ensure_ready(self) -> None:
        """Starts the job process, or replaces it, if needed, and waits until it is warm. Raises ChildDied."""
        if self._child is not None and (not self._child.alive() or self._needs_replacement()):
            self.close()
        if self._child is not None:
            return
        started = time.monotonic()
        child = self._child = Child("scene_attack_worker.job_process", self._settings)
        try:
            while (ready := child.receive(POLL_SECONDS)) is None:
                processes.say_alive()
                hangs = child.idle_seconds() > self._settings.stall_seconds
                if self.stopping or hangs or time.monotonic() - started > START_SECONDS:
                    self.close()
                    raise ChildDied
        except OutOfMemory as error:
            self.close()
            raise ChildDied from error
        self._jobs, self._memory = 0, child.memory()
        self.abilities = Abilities(**ready["abilities"])
        log.info("job process ready", pid=child.pid, seconds=round(time.monotonic() - started, 2))

    def _needs_replacement(self) -> bool:
        assert self._child is not None
        return self._jobs >= MAX_JOBS or self._child.memory() - self._memory > MAX_GROWTH

    def run(self, priority: Priority, beat: Callable[[], None]) -> None:
        """Leases and runs the next job of a priority until it ends, fails, is cancelled, or is queued again because the
        worker stops. Does nothing if no such job is queued that this worker can run.

        Calls `beat` about once a second. Raises ChildDied if no job process can be started. If the database does not
        answer, the supervisor rings again: the job is queued, or its lease lapses.
        """
        self.ensure_ready()
        try:
            attempt = self._lease(priority)
        except SQLAlchemyError as error:
            log.warning("no job taken, the database does not answer", error=str(error))
            return
        if attempt is None:
            return
        job_id = attempt.job_id
        log.info("job taken", job=job_id, attempt=attempt.number)
        self._jobs += 1
        try:
            self._watch(attempt, beat)
        except ChildDied:
            self.close()
            log.warning("attempt lost with its job process", job=job_id, attempt=attempt.number)
            with suppress(SQLAlchemyError):
                self._record.leases.lose(attempt)
        except OutOfMemory as error:
            log.warning("job process ended, it has too much memory", job=job_id, attempt=attempt.number)
            with suppress(SQLAlchemyError):  # before the process has ended: freeing gigabytes may outlast the lease
                self._record.leases.fail(attempt, "out-of-memory", f"the job needed {error}")
            self.close()
        except BaseException:
            self.close()  # nobody would watch the job, and its answer would be taken for that of the next one
            raise

    def _lease(self, priority: Priority) -> Attempt | None:
        for _ in range(TURNS):
            job_id = self._record.scheduler.next_job(priority, self.abilities)
            if job_id is None:
                return None
            attempt = self._record.leases.lease(job_id, self._owner, self._settings.lease_seconds)
            if attempt is not None:
                return attempt
        return None

    def _watch(self, attempt: Attempt, beat: Callable[[], None]) -> None:
        child = self._child
        assert child is not None
        started = renewed = time.monotonic()
        stop_requested_at: float | None = None
        child.send({"job": attempt.job_id, "attempt": attempt.number})
        while (answer := child.receive(POLL_SECONDS)) is None:
            now = time.monotonic()
            processes.say_alive()
            if self.stopping:
                self.close()
                self._record.leases.give_back(attempt)
                log.info("job given back", job=attempt.job_id)
                return
            if now - started > self._settings.job_seconds:
                self.close()
                why = f"it ran longer than {self._settings.job_seconds:g} seconds"
                self._record.leases.fail(attempt, "timeout", why)
                return
            if child.idle_seconds() > self._settings.stall_seconds:
                log.warning("job process hangs", job=attempt.job_id, attempt=attempt.number, pid=child.pid)
                raise ChildDied
            if stop_requested_at is not None and now - stop_requested_at > STOP_SECONDS:
                self.close()
                self._record.leases.cancelled(attempt)  # changes nothing if the attempt was lost
                return
            if now - renewed < min(1.0, self._settings.lease_seconds / 4):
                continue
            renewed = now
            beat()
            if self._renew(attempt) is not Standing.GO_ON and stop_requested_at is None:
                stop_requested_at = now

        if "outage" in answer:
            self._put_off(attempt, answer["outage"])

    def usable(self) -> bool:
        """Whether the database and the store answer and the data directory can be written, as every job needs."""
        try:
            self._record.database.ping()
        except SQLAlchemyError:
            return False
        return self._storage.usable()

    def _put_off(self, attempt: Attempt, outage: str) -> None:
        """Queues a job again whose attempt was ended by an outage. It counts only if the outage cannot be seen."""
        unseen = self.usable()
        while not self.stopping:
            processes.say_alive()
            try:
                if unseen:
                    self._record.leases.lose(attempt, f"it met an outage ({outage})")
                else:
                    self._record.leases.give_back(attempt)
            except SQLAlchemyError:
                time.sleep(RETRY_SECONDS)
            else:
                log.warning("job put off", job=attempt.job_id, outage=outage)
                return

    def _renew(self, attempt: Attempt) -> Standing:
        try:
            return self._record.leases.renew(attempt, self._settings.lease_seconds)
        except SQLAlchemyError as error:
            # The lease has not lapsed yet. If the database stays unreachable, another supervisor takes the job back.
            log.warning("lease not renewed", job=attempt.job_id, error=str(error))
            return Standing.GO_ON


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
        processes.say_alive()
        super().heartbeat(timeout, pipeline)
        self._queue.alive(self.name, self._runner.abilities)

    def register_death(self) -> None:
        """Records that this worker has ended."""
        processes.say_alive()
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
        for queue in self.queues:
            clean_worker_registry(queue)
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
    processes.say_alive()
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
