"""What the routes take from a request: the app's services, the caller, the body and the preferences of a submission.

A JSON body is parsed in a thread, so that a large or costly one delays no other.
"""

import asyncio
import re
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Body, Depends, Header, HTTPException, Query, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema
from redis.exceptions import RedisError

from scene_attack.client.schemas import JobView
from scene_attack.client.states import Priority
from scene_attack.errors import InvalidRequest
from scene_attack.scenes.library import Library
from scene_attack.strict import NESTED, Names, is_nested_deeper
from scene_attack_api.problems import BadRequestField
from scene_attack_api.submissions import Checks, Submissions
from scene_attack_api.uploads import MeshUploads
from scene_attack_api.warm_pool import Exporter, WarmPool
from scene_attack_api.watchers import Watcher
from scene_attack_service.access.caller import Caller, OwnedAssets, Quotas
from scene_attack_service.access.keys import AccessKeys, Sessions
from scene_attack_service.jobs.campaigns import Counts
from scene_attack_service.jobs.files import ArtifactStore, Storage
from scene_attack_service.jobs.models import Job
from scene_attack_service.jobs.queue import Demand, Device, Queue
from scene_attack_service.jobs.record import Record
from scene_attack_service.jobs.uploads import DeletedAssets


async def known_caller(request: Request) -> Caller | None:  # a function that is not async would be called in a thread
    """Returns the sender of a request to an open route; None if unknown."""
    sender = request.scope["state"]["caller"]
    assert sender is None or isinstance(sender, Caller)
    return sender


KnownCaller = Annotated[Caller | None, Depends(known_caller)]


async def caller(request: Request) -> Caller:
    """Returns the sender of a request to a route that needs a key."""
    sender = await known_caller(request)
    assert sender is not None
    return sender


CallerDependency = Annotated[Caller, Depends(caller)]


async def client(request: Request, caller: CallerDependency) -> str:
    """Returns the client whose turn a request takes: its owner, or its address if nobody has a key."""
    return f"owner {caller.owner}" if caller.key else "" if request.client is None else request.client.host


Client = Annotated[str, Depends(client)]


@dataclass(frozen=True)
class Services:
    """Keys, sessions, uploads and quotas, the record of jobs and campaigns, the queue, the files, and what checks,
    previews, exports and watches.
    """

    keys: AccessKeys
    sessions: Sessions
    assets: OwnedAssets
    quotas: Quotas
    record: Record
    queue: Queue
    submissions: Submissions
    store: ArtifactStore
    library: Library
    pool: WarmPool
    checks: Checks
    uploads: MeshUploads
    exporter: Exporter
    watcher: Watcher
    storage: Storage
    deleted_assets: DeletedAssets

    def campaign_counts(self, campaign_id: str) -> Counts:
        """The results of a campaign so far, and the time left with as many workers as there are now."""
        try:
            workers = self.queue.live_workers()
        except RedisError:
            workers = 1
        return self.record.campaigns.counts(campaign_id, workers)


async def services(request: Request) -> Services:  # a function that is not async would be called in a thread
    """The app's services."""
    provided = request.app.state.services
    assert isinstance(provided, Services)
    return provided


ServicesDependency = Annotated[Services, Depends(services)]


def known_job(job_id: str, services: ServicesDependency, caller: CallerDependency) -> Job:
    """The job with the id in the path, without request and result. Answers 404 if there is none for the caller."""
    job = caller.visible(services.record.jobs.line(job_id))
    if job is None:
        raise no_such("job")
    return job


KnownJob = Annotated[Job, Depends(known_job)]


def names_of(services: Services, caller: Caller) -> Names:
    """The context in which the names in a caller's request are looked up."""
    return services.submissions.names(caller)


def no_such(what: str) -> HTTPException:
    """The 404 error for a part of the path; `what` is its kind, e.g. "job"."""
    return HTTPException(404, f"there is no such {what}")


def matches(if_none_match: str, etag: str) -> bool:
    """Whether an `If-None-Match` has an ETag, weak or strong, or `*`."""
    name = etag.removeprefix("W/").strip('"')
    return if_none_match.strip() == "*" or name in re.findall(r'"([^"]*)"', if_none_match)


Parsed = TypeVar("Parsed", bound=BaseModel)


class _Unparsed:
    """Marks JSON that is taken as it is, and described in the OpenAPI document as the model it will be parsed into."""

    def __init__(self, model: type[BaseModel]) -> None:
        self.model = model

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Anything is valid."""
        return core_schema.any_schema()

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """A reference to the schema of the model."""
        # Pydantic refers to a model that is part of another schema, and would write out one that stands alone.
        return handler(core_schema.definitions_schema(self.model.__pydantic_core_schema__, []))


def body_of(model: type[Parsed]) -> Callable[..., Parsed]:
    """Returns a dependency that parses the body. It answers 422 as if the framework had parsed the body.

    What follows from a scene's file is filled in. Of a body that is invalid, the names in it that there are not are
    invalid, too.
    """

    def parsed(
        data: Annotated[Any, Body(), _Unparsed(model)], services: ServicesDependency, caller: CallerDependency
    ) -> Parsed:
        if is_nested_deeper(data):
            raise BadRequestField(InvalidRequest("body", NESTED))
        try:
            return model.model_validate(data, context={"scene": names_of(services, caller)["scene"]})
        except ValidationError as error:
            items = _with_names(data, model, error, names_of(services, caller)).errors(include_url=False)
            raise RequestValidationError([item | {"loc": ("body", *item["loc"])} for item in items]) from error

    return parsed


def _with_names(data: Any, model: type[BaseModel], error: ValidationError, names: Names) -> ValidationError:
    try:
        model.model_validate(data, context=names)
    except ValidationError as whole:
        return whole
    return error


MOST_MEMORY = 2**50
"""Most bytes of memory that a client may ask for; far more than any machine has."""


def demand(default: Priority) -> Callable[..., Demand]:
    """Returns a dependency that reads what a submission asks of the queue."""

    def read(
        priority: Annotated[
            Priority, Query(description="jobs of a higher priority are taken first; within one, owners take turns")
        ] = default,
        device: Annotated[
            Device | None, Query(description="kind of device that the worker must have; default: any")
        ] = None,
        memory: Annotated[
            int, Query(ge=0, le=MOST_MEMORY, description="bytes of memory that the worker must allow a job")
        ] = 0,
    ) -> Demand:
        return Demand(priority, device, memory)

    return read


LONGEST_WAIT = 30.0
"""Largest N of `Prefer: wait=N`, in seconds; larger values are reduced to it."""


def json_body(request: Request) -> None:
    """Answers 415 unless the content type is JSON, which a form of another web site cannot send."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json" and not re.fullmatch(r"application/[\w.-]+\+json", kind):
        raise HTTPException(415, "send the body as application/json")


def wait_preferred(prefer: Annotated[str | None, Header()] = None) -> float | None:
    """The seconds of `Prefer: wait=N` (RFC 7240), at most `LONGEST_WAIT`; None if the header has no such preference."""
    match = re.search(r"(?:^|,)\s*wait\s*=\s*\"?(\d{1,9})\"?\s*(?:;[^,]*)?(?:,|$)", prefer or "", re.IGNORECASE)
    return None if match is None else min(float(match[1]), LONGEST_WAIT)


SUBMISSION: dict[str, Any] = {
    "status_code": 202,
    "responses": {200: {"model": JobView, "description": "the job has ended within the time of `Prefer: wait`"}},
    "dependencies": [Depends(json_body)],
}
"""Settings of the routes that submit a job."""
PreferredWait = Annotated[float | None, Depends(wait_preferred)]
DemandOfQuery = Annotated[Demand, Depends(demand(Priority.NORMAL))]
IdempotencyKey = Annotated[
    str | None,
    Header(min_length=1, max_length=255, description="a repeated key gets the first answer again, and no new job"),
]


POLL_SECONDS = 0.2
"""Time between two looks at the connection."""

Found = TypeVar("Found")


async def while_connected(request: Request, work: Coroutine[Any, Any, Found]) -> Found:
    """Returns what `work` returns. Cancels it, and raises HTTPException, once the client is gone."""
    working = asyncio.ensure_future(work)
    leaving = asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait({working, leaving}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise HTTPException(408, "the connection was closed before the answer")
        return working.result()
    finally:
        working.cancel()
        leaving.cancel()


async def _gone(request: Request) -> None:
    while not await request.is_disconnected():
        await asyncio.sleep(POLL_SECONDS)
