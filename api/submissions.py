"""Submission of jobs: what `POST /v1/jobs` and the routes like it do that is not HTTP. Names, quotas, repeated keys,
and the bell that wakes a worker.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from redis.exceptions import RedisError
from sqlalchemy.exc import IntegrityError
from starlette.concurrency import run_in_threadpool

from api.schemas import JobView
from services.access.caller import Caller, Quotas
from services.jobs.jobs import Key
from services.jobs.models import Artifact, Job, JobKind
from services.jobs.queue import Queue
from services.jobs.record import Record
from services.jobs.scheduler import Demand, Needs
from services.logs import logger
from services.names import Names
from services.pipeline.check import Checked, check_names
from services.pipeline.spec import SENT_IMAGE, JobSpec, RerenderingSpec, digest, parse

log = logger(__name__)


def key_of(value: str | None, request: JobSpec | RerenderingSpec, caller: Caller) -> Key | None:
    """The idempotency key that a client sent with a request, if it sent one."""
    return None if value is None else Key(value, digest(request), caller.owner)


@dataclass(frozen=True)
class Submissions:
    """Turns requests into queued jobs, of which at most `max_queued` may be queued."""

    record: Record
    queue: Queue
    quotas: Quotas
    names: Callable[[Caller], Names]
    """The names that a request of a caller may have."""
    max_queued: int

    async def earlier(self, key: Key | None) -> JobView | None:
        """The answer to the first request with a key; None for a new key. Raises KeyReused for another request."""
        answer = None if key is None else await run_in_threadpool(self.record.jobs.first_answer, key)
        return None if answer is None else JobView.model_validate(answer)

    async def submit(
        self,
        request: JobSpec | RerenderingSpec,
        checked: Checked | None,
        caller: Caller,
        demand: Demand,
        key: Key | None,
        file: Artifact | None = None,
    ) -> JobView:
        """Queues a job, and returns it, or the first answer if another request with the key was quicker.

        A worker checks first whether a request can run that was not `checked`. The job begins with `file`, if given.
        Raises QueueFull, QuotaExceeded, and KeyReused.
        """
        return await run_in_threadpool(self._submit, request, checked, caller, demand, key, file=file)

    def retry(self, caller: Caller, job: Job, checkpoint: Artifact | None = None) -> JobView:
        """Queues a job with the request, priority, device and memory of `job`, which was read with its request.

        The new job belongs to the caller and to no campaign; a worker checks it before it runs. It goes on from
        `checkpoint`, a file of `job`, if given. Raises InvalidRequest if the request cannot run any more, and as
        `submit` does.
        """
        request: JobSpec | RerenderingSpec
        if job.kind is JobKind.RERENDERING:
            request = RerenderingSpec.model_validate(job.spec)
            attack, file = request.attack(), self.record.jobs.artifact(job.id, SENT_IMAGE)
        else:
            request = attack = parse(job.spec)
            file = checkpoint
        check_names(attack, self.names(caller))
        needs = Needs.read(job.needs)
        demand = Demand(job.priority, needs.device, needs.memory)
        return self._submit(request, None, caller, demand, None, file=file, retry_of=job.id)

    def _submit(
        self,
        request: JobSpec | RerenderingSpec,
        checked: Checked | None,
        caller: Caller,
        demand: Demand,
        key: Key | None,
        **about: Any,
    ) -> JobView:
        if isinstance(request, JobSpec) and checked is not None:
            request = checked.spec
        warnings = () if checked is None else checked.warnings
        about |= {"checked": checked is not None, "owner": caller.owner, "demand": demand}
        about |= {"owner_queued": self.quotas.queued_of(caller.owner)}
        arguments = (request, self.max_queued, key, _answer, warnings)
        try:
            job, answer = self.record.jobs.create(*arguments, **about)
        except IntegrityError:  # another process recorded the same key at the same moment
            job, answer = self.record.jobs.create(*arguments, **about)
        if job is not None:
            self._ring(job)
        return JobView.model_validate(answer)

    def _ring(self, job: Job) -> None:
        try:
            self.queue.ring(job.priority)
        except RedisError as error:
            # The job is recorded; the supervisor rings for it when Redis answers again.
            log.warning("queue out of reach, job waits in the record", job=job.id, error=str(error))
        else:
            log.info("job queued", job=job.id)


def _answer(job: Job) -> dict[str, Any]:
    return JobView.of(job).model_dump(mode="json")
