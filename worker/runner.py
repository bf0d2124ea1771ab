"""Runs one job at a time: leases it, sends it to the warm job process, and watches that process until the job ends.

The worker's process loads neither torch nor OpenGL, so it survives a crash of the job process and can report it.
"""

import time
from collections.abc import Callable
from contextlib import suppress

from sqlalchemy.exc import SQLAlchemyError

from services.jobs import watchdog
from services.jobs.child import Child, ChildDied, OutOfMemory
from services.jobs.files import ArtifactStore, Storage
from services.jobs.leases import Attempt, Standing
from services.jobs.placement import NOTHING, Abilities, Priority
from services.jobs.record import Record
from services.logs import logger
from services.settings import Settings

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
        self._stopping = False
        self._abilities = NOTHING

    @property
    def stopping(self) -> bool:
        """Whether the worker was asked to stop."""
        return self._stopping

    def request_stop(self) -> None:
        """Makes `run` queue a running job again and return. May be called in a signal handler."""
        self._stopping = True

    def close(self) -> None:
        """Kills the job process."""
        if self._child is not None:
            self._child.kill()
            self._child = None

    @property
    def abilities(self) -> Abilities:
        """What the job process has, once it has been ready."""
        return self._abilities

    def ensure_ready(self) -> None:
        """Starts the job process, or replaces it, if needed, and waits until it is warm. Raises ChildDied."""
        if self._child is not None and (not self._child.alive() or self._needs_replacement()):
            self.close()
        if self._child is not None:
            return
        started = time.monotonic()
        child = self._child = Child("worker.job_process", self._settings)
        try:
            while (ready := child.receive(POLL_SECONDS)) is None:
                watchdog.alive()
                hangs = child.idle_seconds() > self._settings.stall_seconds
                if self._stopping or hangs or time.monotonic() - started > START_SECONDS:
                    self.close()
                    raise ChildDied
        except OutOfMemory as error:
            self.close()
            raise ChildDied from error
        self._jobs, self._memory = 0, child.memory()
        self._abilities = Abilities.of(ready["abilities"])
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
            job_id = self._record.scheduler.next_job(priority, self._abilities)
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
            watchdog.alive()
            if self._stopping:
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
        while not self._stopping:
            watchdog.alive()
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
