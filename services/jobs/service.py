"""Taking requests: what the API's routes do with jobs, apart from HTTP."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from redis.exceptions import RedisError
from sqlalchemy.exc import IntegrityError

from services.jobs.models import Job
from services.jobs.queue import Queue
from services.jobs.repository import Key, Repository
from services.logs import logger
from services.pipeline.spec import JobSpec

log = logger(__name__)


@dataclass(frozen=True)
class Submissions:
    """Makes jobs of specs that were found good."""

    repository: Repository
    queue: Queue
    max_queued: int

    def submit(self, spec: JobSpec, key: Key | None, answer: Callable[[Job], dict[str, Any]]) -> dict[str, Any]:
        """Record the job, then send its id. Returns `answer(job)`, or the first answer of a key that came again.

        Raises QueueFull, and KeyReused where the key came with another request.
        """
        try:
            job, said = self.repository.create(spec, self.max_queued, key, answer)
        except IntegrityError:  # the same key, at the same moment, from another process
            job, said = self.repository.create(spec, self.max_queued, key, answer)
        if job is not None:
            self._send(job)
        return said

    def _send(self, job: Job) -> None:
        try:
            self.queue.send(job.id, job.attempt)
        except RedisError as error:
            # The row is there; the supervisor sends it when Redis is back.
            log.warning("queue out of reach, job waits in the record", job=job.id, error=str(error))
            return
        self.repository.sent(job.id, job.attempt)
        log.info("job queued", job=job.id)


def digest(spec: JobSpec) -> str:
    """What an idempotency key stands for: the request with its defaults filled in."""
    return hashlib.sha256(spec.model_dump_json().encode()).hexdigest()
