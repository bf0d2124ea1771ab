"""What becomes of a request that is no HTTP: it is checked, previewed and queued."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fastapi import HTTPException
from redis.exceptions import RedisError
from sqlalchemy.exc import IntegrityError
from starlette.concurrency import run_in_threadpool

from scene_attack.client.schemas import JobView
from scene_attack.errors import InvalidRequest
from scene_attack.logs import logger
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.check import check_size, placed, samples
from scene_attack.runs.result import JobWarning, PlannedCost, Preview
from scene_attack.runs.spec import SENT_IMAGE, JobSpec, RerenderingSpec, check_names, digest, parse
from scene_attack.strict import Names
from scene_attack_api.views import job_view
from scene_attack_api.warm_pool import NoneFree, TooSlow, Unavailable, WarmPool
from scene_attack_service.access.caller import Caller, Quotas
from scene_attack_service.jobs.jobs import Key
from scene_attack_service.jobs.models import Artifact, Job, JobKind
from scene_attack_service.jobs.processes import ChildDied, OutOfMemory
from scene_attack_service.jobs.queue import Demand, Needs, Queue
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings

WAITING_SHARE = 0.1
"""Longest wait of a check for a process, as a share of the time that it may take: 0.5 seconds by default."""
PREVIEW_SHARE = 2
"""Longest preview, longest plan and longest wait for either, as a multiple of the time that a check may take."""
MOST_SLOW = 1000
"""Number of requests that are remembered since their check took too long."""
TOO_LARGE = "ask for a smaller image, a smaller environment map or fewer objects"
log = logger(__name__)


@dataclass(frozen=True)
class Checked:
    """A request that can run: its spec as it would run, and what its sender is warned of."""

    spec: JobSpec
    warnings: tuple[JobWarning, ...]


class Checks:
    """Checks requests before they are accepted. Nothing of a request is checked anywhere else."""

    def __init__(self, pool: WarmPool, names: Callable[[Caller], Names], settings: Settings) -> None:
        """names: the names that a request of a caller may have."""
        self._pool = pool
        self._names = names
        self._settings = settings
        self._slow: dict[str, None] = {}
        """Digests of requests whose check took too long, of which the newest are kept: a worker checks the next one."""

    async def check(self, spec: JobSpec, caller: Caller) -> Checked | None:
        """Returns the request as it would run, and warnings; None if that could not be found out in time.

        Raises InvalidRequest if it cannot run, and Unavailable.
        """
        await run_in_threadpool(lambda: check_names(spec, self._names(caller)))
        return await self._check(spec)

    async def check_campaign(self, campaign: CampaignSpec, caller: Caller) -> None:
        """Checks the size of a campaign, its names, and one job of each kind, in the time that a preview may take.

        Raises as `check` does. Kinds for which no time is left are not checked.
        """
        await run_in_threadpool(check_size, campaign)
        await run_in_threadpool(lambda: check_names(campaign, self._names(caller)))
        end = time.monotonic() + PREVIEW_SHARE * self._settings.check_seconds
        for spec, places in await run_in_threadpool(lambda: list(samples(campaign))):
            if time.monotonic() > end:
                return
            try:
                await self._check(spec)
            except InvalidRequest as error:
                raise placed(error, places) from error

    async def preview(self, spec: JobSpec, caller: Caller, client: str) -> tuple[Preview, str]:
        """Returns a request's preview, and the image of its scene as a PNG file in base64.

        Raises InvalidRequest if the request cannot run, HTTPException(413) if that takes too long, and Unavailable.
        """
        await run_in_threadpool(lambda: check_names(spec, self._names(caller)))
        answer = await self._preview("preview", spec, client)
        return Preview.model_validate(answer["preview"]), answer["png"]

    async def plan(self, spec: JobSpec, client: str) -> PlannedCost:
        """Returns the plan of a request that was previewed, and its cost. Raises as `preview` does."""
        return PlannedCost.model_validate(await self._preview("plan", spec, client))

    async def _check(self, spec: JobSpec) -> Checked | None:
        seconds, without_seed = self._settings.check_seconds, digest(spec.model_copy(update={"seed": 0}))
        if without_seed in self._slow:
            return None
        try:
            message = {"check": spec.model_dump(mode="json")}
            answer = await self._pool.check(message, WAITING_SHARE * seconds, seconds)
        except NoneFree:
            return None
        except TooSlow:
            self._slow[without_seed] = None
            if len(self._slow) > MOST_SLOW:
                del self._slow[next(iter(self._slow))]
            return None
        except ChildDied as error:
            raise Unavailable("the check of this request was cut short; try again") from error
        except OutOfMemory as error:
            raise _too_large(error) from error
        warnings = tuple(JobWarning.model_validate(warning) for warning in answer["warnings"])
        return Checked(JobSpec.model_validate(answer["spec"]), warnings)

    async def _preview(self, what: str, spec: JobSpec, client: str) -> dict[str, Any]:
        seconds = PREVIEW_SHARE * self._settings.check_seconds
        try:
            return await self._pool.work({what: spec.model_dump(mode="json")}, client, seconds, seconds)
        except NoneFree as error:
            raise Unavailable(f"other previews took longer than {seconds:g} s; try again") from error
        except TooSlow as error:
            thing = "its plan" if what == "plan" else "its scene"
            shorter = ", or leave the plan out" if what == "plan" else ""
            detail = f"{thing} takes longer than the {seconds:g} s of a preview; ask for a smaller image, fewer objects"
            raise HTTPException(
                413, f"{detail} or smaller maps{shorter}. A job of this request may still run"
            ) from error
        except ChildDied as error:
            raise Unavailable("the preview was cut short; try again") from error
        except OutOfMemory as error:
            raise _too_large(error) from error


def _too_large(error: OutOfMemory) -> InvalidRequest:
    return InvalidRequest("scene", f"rendering it once takes {error}; {TOO_LARGE}")


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

    def retry(self, caller: Caller, job_id: str, checkpoint: Artifact | None = None) -> JobView:
        """Queues a job with the request, priority, device and memory of another one.

        The new job belongs to the caller and to no campaign; a worker checks it before it runs. It goes on from
        `checkpoint`, a file of the other, if given. Raises InvalidRequest if the request cannot run any more,
        HTTPException(404) if there is no such job any more, and as `submit` does.
        """
        job = self.record.jobs.get(job_id)
        if job is None:
            raise HTTPException(404, "there is no such job")
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
    return job_view(job).model_dump(mode="json")
