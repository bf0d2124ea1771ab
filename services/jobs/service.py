"""Submission of jobs: the part of the API's `POST /v1/jobs` that does not depend on HTTP."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from redis.exceptions import RedisError
from sqlalchemy.exc import IntegrityError

from services.jobs.models import Artifact, Job
from services.jobs.placement import NO_DEMAND, Demand, Needs
from services.jobs.queue import Queue
from services.jobs.repository import Key, Repository
from services.logs import logger
from services.pipeline.spec import JobSpec
from services.pipeline.warning import JobWarning

log = logger(__name__)


@dataclass(frozen=True)
class Submissions:
    """Turns checked specs into jobs. At most `max_queued` jobs may be queued."""

    repository: Repository
    queue: Queue
    max_queued: int

    def submit(
        self,
        spec: JobSpec,
        key: Key | None,
        answer: Callable[[Job], dict[str, Any]],
        warnings: Sequence[JobWarning] = (),
        *,
        checked: bool = True,
        owner: str = "",
        owner_queued: int | None = None,
        demand: Demand = NO_DEMAND,
        retry_of: str | None = None,
        checkpoint: Artifact | None = None,
    ) -> dict[str, Any]:
        """Records the job, then sends its id. Returns `answer(job)`, or the first answer if the key was used before.

        A worker checks first whether a spec that was not `checked` can run. `retry_of` is the job that it repeats; it
        goes on from `checkpoint`, a file of that job, if given.

        Raises QueueFull, QuotaExceeded if the owner has `owner_queued` jobs queued, and KeyReused if the key came with
        another request.
        """
        given = (spec, self.max_queued, key, answer, warnings)
        about: dict[str, Any] = {"checked": checked, "owner": owner, "owner_queued": owner_queued, "demand": demand}
        about |= {"retry_of": retry_of, "checkpoint": checkpoint}
        create = partial(self.repository.create, *given, **about)
        try:
            job, said = create()
        except IntegrityError:  # another process recorded the same key at the same moment
            job, said = create()
        if job is not None:
            self._send(job)
        return said

    def _send(self, job: Job) -> None:
        try:
            self.queue.send(job.id, job.attempt, job.priority, Needs.read(job.needs))
        except RedisError as error:
            # The job is recorded; the supervisor sends it when Redis answers again.
            log.warning("queue out of reach, job waits in the record", job=job.id, error=str(error))
            return
        self.repository.sent(job.id, job.attempt)
        log.info("job queued", job=job.id)
