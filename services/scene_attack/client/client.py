"""Clients of a running service, for programs: `Client`, and `AsyncClient` for asyncio, with the jobs that they return.

Both send the requests of `scene_attack.client.operations` and read the answers into the models that these name. They
differ in how they wait. They raise `ApiError` if the service refuses, and httpx.HTTPError if it does not answer. A
service that is busy (503) is asked again a few times.
"""

from __future__ import annotations

import io
import os
import re
from asyncio import get_running_loop, run_coroutine_threadsafe, to_thread
from asyncio import sleep as async_sleep
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from time import sleep
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, Unpack

import httpx
from httpx_sse import ServerSentEvent, aconnect_sse, connect_sse
from pydantic import BaseModel, ValidationError

from scene_attack import disk
from scene_attack.client import DEFAULT_URL, operations
from scene_attack.client.errors import Unfinished, refusal
from scene_attack.client.meshes import sent
from scene_attack.client.operations import Answer, JobFilter, Request, Submission
from scene_attack.client.states import State
from scene_attack.errors import InvalidRequest
from scene_attack.extras import extra
from scene_attack.runs.spec import NOT_SENT, RerenderingView, as_data, is_network

if TYPE_CHECKING:
    from pandas import DataFrame
    from PIL.Image import Image

    from scene_attack.analysis.records import Subset
    from scene_attack.attacks.trace import TraceRow
    from scene_attack.client.schemas import (
        BadField,
        CampaignSummary,
        CampaignView,
        FailureView,
        JobSummary,
        JobView,
        Uploaded,
    )
    from scene_attack.runs.campaign_spec import CampaignSpec
    from scene_attack.runs.result import Outcome, Result
    from scene_attack.runs.spec import JobSpec, RerenderingSpec

PATIENCE = 30.0
"""Seconds without a byte after which an event stream counts as dropped; the service sends a comment more often."""
PAGE = 200
"""Number of jobs that are asked for at once."""
TRIES = 3
"""Largest number of times that a request is sent to a service that is busy."""
MAX_PAUSE = 5.0
"""Longest pause before a request is sent again, in seconds; the first pauses are shorter."""
RECONNECTS = 8
"""Number of connections in a row that brought no event, after which an event stream is given up."""

Loaded = TypeVar("Loaded")
Row = TypeVar("Row", bound=BaseModel)


class Rows(list[Row], Generic[Row]):
    """The rows of a table, such as the subsets of a result: models with the same fields."""

    def to_frame(self) -> DataFrame:
        """A DataFrame with a line for each row. Raises MissingExtra without pandas, which the rows need not."""
        return pandas_module().DataFrame.from_records([row.model_dump() for row in self])


def pandas_module() -> Any:
    """The module pandas. Raises MissingExtra without it."""
    with extra("pandas", "a DataFrame"):
        import pandas
    return pandas


class Images(Generic[Loaded]):
    """The images of a finished job, RGB of 8 bits; `numpy.asarray` makes an array [H, W, 3] of one."""

    def __init__(self, load: Callable[[str], Loaded]) -> None:
        self._load = load

    @property
    def original(self) -> Loaded:
        """The scene as it was."""
        return self._load("original.png")

    @property
    def attacked(self) -> Loaded:
        """The scene after the attack, as the network was asked about it."""
        return self._load("attacked.png")

    @property
    def perturbation(self) -> Loaded:
        """The difference of the two, times 5, plus 128."""
        return self._load("perturbation.png")


def images(folder: Path | str) -> Images[Image]:
    """The images in a folder of a finished job. Reading one raises FileNotFoundError if it is not there."""
    return Images(cache(lambda name: _opened((Path(folder) / name).read_bytes())))


def _opened(data: bytes) -> Image:
    """The RGB image in a PNG's bytes."""
    import PIL.Image

    return PIL.Image.open(io.BytesIO(data)).convert("RGB")


@dataclass(frozen=True)
class Event:
    """An event of a job: its number, its kind ("state" or "progress") and its data."""

    number: str
    kind: str
    data: dict[str, Any]

    @property
    def last(self) -> bool:
        """Whether the job has ended with it."""
        return self.kind == "state" and State(self.data["state"]).terminal


class JobFields:
    """The fields of a job that need no further request; `data` is the service's answer."""

    def __init__(self, data: JobView) -> None:
        self.data = data

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.id} {self.state}: {self.data.name}, {self.data.attack}>"

    @property
    def id(self) -> str:
        """The job's id, 32 hexadecimal digits."""
        return self.data.id

    @property
    def state(self) -> State:
        """The state when the service was last asked."""
        return self.data.state

    @property
    def ended(self) -> bool:
        """Whether the job has ended: it succeeded, failed, was rejected or cancelled."""
        return self.state.terminal

    @property
    def spec(self) -> JobSpec | RerenderingSpec | dict[str, Any]:
        """The request, with the values of all fields filled in; as JSON, if its attack or renderer is not installed."""
        return self.data.spec

    @property
    def outcome(self) -> Outcome | None:
        """The part of the result that lists show; None until the job has succeeded."""
        return self.data.outcome

    @property
    def failure(self) -> FailureView | None:
        """The failure of the job; None if it did not fail."""
        return self.data.failure

    @property
    def errors(self) -> list[BadField]:
        """The invalid fields of a rejected job."""
        return self.data.errors

    @property
    def result(self) -> Result:
        """The whole result of an attack. Raises Unfinished unless the job succeeded; a re-rendering has none."""
        if self.data.result is None:
            reason = "; ".join(f"{error.field}: {error.detail}" for error in self.errors)
            if self.failure is not None:
                reason = f"{self.failure.kind}: {self.failure.detail}"
            hint = reason if self.ended else "call wait() first"
            raise Unfinished(f"job {self.id} is {self.state}" + (f": {hint}" if hint else ""))
        if isinstance(self.data.result, RerenderingView):
            raise Unfinished(f"job {self.id} is a re-rendering; read its `data.result`")
        return self.data.result

    @property
    def verified(self) -> bool:
        """Whether the stored perturbation, rendered afresh and rounded to 8 bits, fools the network."""
        return self.result.verified

    @property
    def trace(self) -> Rows[TraceRow]:
        """The steps of the attack: a row for each, with its queries, answer, confidence and perceptibility."""
        return Rows(self.result.trace)

    @property
    def subsets(self) -> Rows[Subset]:
        """The subsets of the attacked groups: a row for each, with the answer to that part of the change alone."""
        return Rows(self.result.subsets)


class Job(JobFields):
    """A job of a service."""

    def __init__(self, data: JobView, client: Client) -> None:
        super().__init__(data)
        self._client = client

    @cached_property
    def images(self) -> Images[Image]:
        """The images before and after. Reading one raises ApiError (404) if the job has no result."""
        return Images(cache(lambda name: _opened(self.file(name))))

    def file(self, name: str) -> bytes:
        """The bytes of one of the job's files, e.g. "perturbation.safetensors"."""
        return self._client.call(operations.download_artifact(self.id, name))

    def files(self) -> list[str]:
        """The names of the job's files; none until it has succeeded."""
        return [file.name for file in self._client.call(operations.list_artifacts(self.id)).items]

    def download(self, folder: Path | str) -> list[Path]:
        """Writes all files of the job into a folder, as `scene-attack run --out` does, and returns their paths."""
        paths = []
        for name in self.files():
            path = Path(folder) / Path(name).name  # a service can name no file outside the folder
            self._client.save(operations.download_artifact(self.id, name), path)
            paths.append(path)
        return paths

    def refresh(self) -> Job:
        """Asks the service for the job's state and result; returns this job."""
        self.data = self._client.call(operations.get_job(self.id))
        return self

    def watch(self) -> Iterator[Event]:
        """The job's events, each once and in order, until it has ended; a dropped connection is taken up again."""
        yield from self._client.stream_job_events(self.id)
        self.refresh()

    def wait(self) -> Job:
        """Waits until the job has ended; returns this job, with its result if it succeeded."""
        if not self.ended:
            for _ in self.watch():
                pass
        return self.refresh() if self.ended and self.data.result is None else self

    def cancel(self) -> Job:
        """Asks the job to stop; returns this job. One that has ended stays as it is."""
        self._client.call(operations.cancel_job(self.id))
        return self.refresh()

    def retry(self) -> Job:
        """Queues the job's request again; returns the new job."""
        return Job(self._client.call(operations.retry_job(self.id)), self._client)

    def continue_(self) -> Job:
        """Queues a job that goes on from the checkpoint of this one, which was cancelled or failed; returns it.

        ApiError with status 409 if it has not ended so, or ended before its first checkpoint.
        """
        return Job(self._client.call(operations.continue_job(self.id)), self._client)

    def delete(self) -> None:
        """Deletes the job with its files. ApiError with status 409 if it has not ended, or a campaign refers to it."""
        self._client.call(operations.delete_job(self.id))


class AsyncJob(JobFields):
    """A job of a service; methods that send a request are awaited."""

    def __init__(self, data: JobView, client: AsyncClient) -> None:
        super().__init__(data)
        self._client = client

    @cached_property
    def images(self) -> Images[Coroutine[None, None, Image]]:
        """The images before and after, each to be awaited: `await job.images.attacked`."""
        return Images(self._image)

    async def _image(self, name: str) -> Image:
        return _opened(await self.file(name))

    async def file(self, name: str) -> bytes:
        """The bytes of one of the job's files."""
        return await self._client.call(operations.download_artifact(self.id, name))

    async def files(self) -> list[str]:
        """The names of the job's files; none until it has succeeded."""
        return [file.name for file in (await self._client.call(operations.list_artifacts(self.id))).items]

    async def download(self, folder: Path | str) -> list[Path]:
        """Writes all files of the job into a folder, as `scene-attack run --out` does, and returns their paths."""
        paths = []
        for name in await self.files():
            path = Path(folder) / Path(name).name  # a service can name no file outside the folder
            await to_thread(disk.write, path, await self.file(name))
            paths.append(path)
        return paths

    async def refresh(self) -> AsyncJob:
        """Asks the service for the job's state and result; returns this job."""
        self.data = await self._client.call(operations.get_job(self.id))
        return self

    async def watch(self) -> AsyncIterator[Event]:
        """The job's events, each once and in order, until it has ended; a dropped connection is taken up again."""
        async for event in self._client.stream_job_events(self.id):
            yield event
        await self.refresh()

    async def wait(self) -> AsyncJob:
        """Waits until the job has ended; returns this job, with its result if it succeeded."""
        if not self.ended:
            async for _ in self.watch():
                pass
        return await self.refresh() if self.ended and self.data.result is None else self

    async def cancel(self) -> AsyncJob:
        """Asks the job to stop; returns this job. One that has ended stays as it is."""
        await self._client.call(operations.cancel_job(self.id))
        return await self.refresh()

    async def retry(self) -> AsyncJob:
        """Queues the job's request again; returns the new job."""
        return AsyncJob(await self._client.call(operations.retry_job(self.id)), self._client)

    async def continue_(self) -> AsyncJob:
        """Queues a job that goes on from the checkpoint of this one, which was cancelled or failed; returns it."""
        return AsyncJob(await self._client.call(operations.continue_job(self.id)), self._client)

    async def delete(self) -> None:
        """Deletes the job with its files. ApiError with status 409 if it has not ended, or a campaign refers to it."""
        await self._client.call(operations.delete_job(self.id))


class Client:
    """Talks to the service at `url` (default: SCENE_ATTACK_URL, or this machine's) with `key` (SCENE_ATTACK_KEY).

    Redirects are not followed, so that the key goes nowhere else. Raises InvalidRequest if URL or key cannot be one.
    Close it after use: `with Client() as client: …`.
    """

    def __init__(
        self, url: str | None = None, *, key: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        self._http = httpx.Client(**_connection(url, key), transport=transport)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    @property
    def url(self) -> str:
        """The URL of the service, without a slash at the end."""
        return str(self._http.base_url).rstrip("/")

    def call(self, request: Request[Answer]) -> Answer:
        """The answer to a request of `scene_attack.client.operations`: `call(operations.list_targets()).items`."""
        tries = 1
        while is_busy(response := self._http.request(**request.arguments())) and tries < TRIES:
            sleep(pause_after(response, tries))
            tries += 1
        return read(request, response)

    def save(self, request: Request[bytes], to: Path) -> None:
        """Writes the file that a request answers to `to`, which appears only when it is complete."""
        with self._http.stream(**request.arguments()) as response:
            if response.status_code != httpx.codes.OK:
                response.read()
                raise refusal(response)
            with disk.replacing(to) as part, part.open("wb") as file:
                for chunk in response.iter_bytes():
                    file.write(chunk)

    def stream_job_events(self, job_id: str, after: str | None = None) -> Iterator[Event]:
        """A job's events, each once and in order, until it has ended; a dropped connection is taken up again."""
        stream = EventStream(job_id, after)
        while not stream.ended():
            try:
                with connect_sse(self._http, **stream.request()) as source:
                    if stream.opened(source.response):
                        for sent in source.iter_sse():
                            if (event := stream.received(sent)) is not None:
                                yield event
                            if stream.ended():
                                return
                    elif not stream.ended():
                        source.response.read()
                        stream.refused(source.response)
            except (httpx.TransportError, httpx.StreamError) as broken:
                stream.error = broken
            if not stream.ended():
                sleep(stream.pause())

    def submit(
        self,
        spec: JobSpec | Mapping[str, Any],
        *,
        folder: Path | str = "",
        say: Callable[[str], None] = lambda _: None,
        **asked: Unpack[Submission],
    ) -> Job:
        """Uploads the meshes of one's own that a request has and the service lacks, and queues the job.

        `spec` is sa.Spec or what it says as a dictionary, whose parts may be objects. A mesh is a path relative to
        `folder` (default: the working directory), or sa.Mesh. `say` is told what is uploaded. Raises InvalidFields,
        which has every wrong field, for a mesh that cannot be uploaded, InvalidRequest for a network or a renderer of
        this process, and ApiError with status 422, which names every invalid field.
        """
        request = partial(operations.submit_job, **asked)
        return Job(sent(_portable(spec), Path.cwd() / folder, self.call, request, say), self)

    def get_job(self, job_id: str) -> Job:
        """One job by its id."""
        return Job(self.call(operations.get_job(job_id)), self)

    def list_jobs(self, **which: Unpack[JobFilter]) -> Iterator[JobSummary]:
        """All jobs that meet a query, newest first or in another order, but without requests and results; asks for one
        page after the other.
        """
        cursor, first = None, True
        while first or cursor is not None:
            page = self.call(operations.list_jobs(limit=PAGE, cursor=cursor, **which))
            yield from page.items
            cursor, first = page.next, False

    def submit_campaign(
        self,
        spec: CampaignSpec | Mapping[str, Any],
        *,
        folder: Path | str = "",
        say: Callable[[str], None] = lambda _: None,
        **asked: Unpack[Submission],
    ) -> CampaignView:
        """Starts a campaign; uploads meshes and raises as `submit` does."""
        request = partial(operations.submit_campaign, **asked)
        return sent(_portable(spec), Path.cwd() / folder, self.call, request, say)

    def list_campaigns(self) -> Iterator[CampaignSummary]:
        """All campaigns, newest first."""
        cursor, first = None, True
        while first or cursor is not None:
            page = self.call(operations.list_campaigns(cursor=cursor))
            yield from page.items
            cursor, first = page.next, False

    def upload_asset(self, path: Path | str, kind: str | None = None, **about: str | None) -> Uploaded:
        """Uploads a mesh with the files beside it that it names, or an environment map, whose `name` goes into scenes.

        `kind` is its format, by default the file's ending; `about` has `mesh`, its name among several in a zip file,
        and what is said of it: `name`, `up`, `licence` and `credit`.
        """
        return self.call(operations.upload_asset([Path(path)], kind, **about))


class AsyncClient:
    """`Client` for asyncio: `async with AsyncClient() as client: job = await client.submit(spec)`."""

    def __init__(
        self, url: str | None = None, *, key: str | None = None, transport: httpx.AsyncBaseTransport | None = None
    ) -> None:
        self._http = httpx.AsyncClient(**_connection(url, key), transport=transport)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._http.aclose()

    async def call(self, request: Request[Answer]) -> Answer:
        """The answer to any request of `scene_attack.client.operations`."""
        tries = 1
        while is_busy(response := await self._http.request(**request.arguments())) and tries < TRIES:
            await async_sleep(pause_after(response, tries))
            tries += 1
        return read(request, response)

    async def stream_job_events(self, job_id: str, after: str | None = None) -> AsyncIterator[Event]:
        """A job's events, each once and in order, until it has ended; a dropped connection is taken up again."""
        stream = EventStream(job_id, after)
        while not stream.ended():
            try:
                async with aconnect_sse(self._http, **stream.request()) as source:
                    if stream.opened(source.response):
                        async for sent in source.aiter_sse():
                            if (event := stream.received(sent)) is not None:
                                yield event
                            if stream.ended():
                                return
                    elif not stream.ended():
                        await source.response.aread()
                        stream.refused(source.response)
            except (httpx.TransportError, httpx.StreamError) as broken:
                stream.error = broken
            if not stream.ended():
                await async_sleep(stream.pause())

    async def submit(
        self,
        spec: JobSpec | Mapping[str, Any],
        *,
        folder: Path | str = "",
        say: Callable[[str], None] = lambda _: None,
        **asked: Unpack[Submission],
    ) -> AsyncJob:
        """As `Client.submit`; meshes are read in another thread."""
        request = partial(operations.submit_job, **asked)
        return AsyncJob(await to_thread(sent, _portable(spec), Path.cwd() / folder, self._caller(), request, say), self)

    def _caller(self) -> Callable[[Request[Any]], Any]:
        """`call` for another thread, while the loop of this one runs."""
        loop = get_running_loop()
        return lambda request: run_coroutine_threadsafe(self.call(request), loop).result()

    async def get_job(self, job_id: str) -> AsyncJob:
        """One job by its id."""
        return AsyncJob(await self.call(operations.get_job(job_id)), self)

    async def list_jobs(self, **which: Unpack[JobFilter]) -> AsyncIterator[JobSummary]:
        """All jobs that meet a query, newest first or in another order, but without requests and results; asks for one
        page after the other.
        """
        cursor, first = None, True
        while first or cursor is not None:
            page = await self.call(operations.list_jobs(limit=PAGE, cursor=cursor, **which))
            for job in page.items:
                yield job
            cursor, first = page.next, False

    async def submit_campaign(
        self,
        spec: CampaignSpec | Mapping[str, Any],
        *,
        folder: Path | str = "",
        say: Callable[[str], None] = lambda _: None,
        **asked: Unpack[Submission],
    ) -> CampaignView:
        """As `Client.submit_campaign`; meshes are read in another thread."""
        request = partial(operations.submit_campaign, **asked)
        return await to_thread(sent, _portable(spec), Path.cwd() / folder, self._caller(), request, say)

    async def list_campaigns(self) -> AsyncIterator[CampaignSummary]:
        """All campaigns, newest first."""
        cursor, first = None, True
        while first or cursor is not None:
            page = await self.call(operations.list_campaigns(cursor=cursor))
            for campaign in page.items:
                yield campaign
            cursor, first = page.next, False

    async def upload_asset(self, path: Path | str, kind: str | None = None, **about: str | None) -> Uploaded:
        """Uploads a mesh with the files beside it that it names, or an environment map, whose `name` goes into scenes.

        `kind` is its format, by default the file's ending; `about` has `mesh`, its name among several in a zip file,
        and what is said of it: `name`, `up`, `licence` and `credit`.
        """
        return await self.call(operations.upload_asset([Path(path)], kind, **about))


def _portable(spec: JobSpec | CampaignSpec | Mapping[str, Any]) -> dict[str, Any]:
    """A request as data. Raises InvalidRequest for a part that only this process has."""
    data = as_data("spec", spec)
    for field, part in data.items():
        if is_network(part):
            raise InvalidRequest(field, NOT_SENT)
        if hasattr(part, "render"):
            detail = "a renderer of this process cannot be sent: send its scene, and name it as the attack's `renderer`"
            raise InvalidRequest(field, detail)
    return {field: as_data(field, part) if isinstance(part, BaseModel) else part for field, part in data.items()}


def _connection(url: str | None, key: str | None) -> dict[str, Any]:
    """The arguments of a client of httpx. Raises InvalidRequest if URL or key cannot be one."""
    base = url or os.environ.get("SCENE_ATTACK_URL") or DEFAULT_URL
    if not re.match(r"https?://[^/]", base):
        raise InvalidRequest("--url", f"{base!r} is no address of a service, such as {DEFAULT_URL}")
    if versioned := re.match(r"(.*?)/v1(/|$)", base):
        raise InvalidRequest("--url", f"{base!r} has /v1, which is added to the address: give {versioned[1]}")
    key = (os.environ.get("SCENE_ATTACK_KEY", "") if key is None else key).strip()
    if not key.isascii() or not key.isprintable():
        raise InvalidRequest("SCENE_ATTACK_KEY", "is no key of this service: those are ASCII and begin with sa_")
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    return {"base_url": base, "headers": headers, "timeout": PATIENCE}


def read(request: Request[Answer], response: httpx.Response) -> Answer:
    """The answer in a response that has been read. Raises ApiError if the service refused the request, and
    httpx.DecodingError if the response is no answer to it.
    """
    answer: Any = request.answer
    if response.is_error:
        raise refusal(response)
    if response.has_redirect_location:  # following it could send the key elsewhere
        raise _no_answer(response, f"sends on to {response.headers['location']}, which is not followed")
    kind = response.headers.get("content-type", "nothing that says what it is")
    content: Any = response.content if answer is bytes else response.text if answer is str else None
    if issubclass(answer, BaseModel):
        try:
            content = answer.model_validate_json(response.content)
        except ValidationError:  # perhaps of a newer service, whose answers have more fields
            content = _known_fields(answer, response, kind)
    elif kind.startswith("text/html"):
        raise _no_answer(response, f"answered HTTP {response.status_code} with {kind}")
    return content  # type: ignore[no-any-return]


def _known_fields(model: type[BaseModel], response: httpx.Response, kind: str) -> BaseModel:
    try:
        return model.model_validate_json(response.content, extra="ignore")
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        message = f"answered HTTP {response.status_code} with {kind}, not JSON"
        if wrong["type"] != "json_invalid":
            field = ".".join(map(str, wrong["loc"])) or "the whole"
            message = f"answered no {model.__name__} of this version ({field}: {wrong['msg']})"
        raise _no_answer(response, message) from error


def _no_answer(response: httpx.Response, message: str) -> httpx.DecodingError:
    return httpx.DecodingError(f"{response.url} {message}", request=response.request)


def is_busy(response: httpx.Response) -> bool:
    """Whether the service did not take the request, but may take it when it is sent again.

    Under too many requests its HTTP server refuses in plain text and without a time to wait, unlike the service itself.
    """
    kind = response.headers.get("content-type", "")
    return response.status_code == httpx.codes.SERVICE_UNAVAILABLE and (
        "retry-after" in response.headers or "json" not in kind
    )


def pause_after(response: httpx.Response, tries: int) -> float:
    """Seconds to wait before a request to a busy service is sent again, after so many tries."""
    after = response.headers.get("retry-after", "")
    return min(float(after) if after.isdigit() else 0.5 * 2.0**tries, MAX_PAUSE)


class EventStream:
    """A job's event stream over all its connections: `after` is the last event that came."""

    def __init__(self, job_id: str, after: str | None = None) -> None:
        self.error: Exception | None = None
        """The error that broke the last connection; None if the stream ended before the job did."""
        self._job_id = job_id
        self._after = after
        self._ended = False
        self._failures = 0
        """Number of connections in a row that brought no event."""

    def ended(self) -> bool:
        """Whether the job has ended, and all its events were received."""
        return self._ended

    def request(self) -> dict[str, Any]:
        """The arguments of the next connection."""
        self.error = None
        return operations.stream_job_events(self._job_id, last_event_id=self._after).arguments()

    def opened(self, response: httpx.Response) -> bool:
        """Whether events follow. No content says that there are no more."""
        self._ended = response.status_code == httpx.codes.NO_CONTENT
        return response.status_code == httpx.codes.OK

    def refused(self, response: httpx.Response) -> None:
        """Raises the ApiError of a response that has been read, unless the service is busy."""
        self.error = refusal(response)
        if not is_busy(response):
            raise self.error

    def received(self, sent: ServerSentEvent) -> Event | None:
        """The event that was sent; None for a comment that keeps the connection alive."""
        self._failures = 0
        if not sent.data:
            return None
        self._after = sent.id
        event = Event(sent.id, sent.event, sent.json())
        self._ended = event.last
        return event

    def pause(self) -> float:
        """Seconds to wait before the next connection. Raises the error, or httpx.RemoteProtocolError if there is none,
        after RECONNECTS connections in vain.
        """
        self._failures += 1
        if self._failures > RECONNECTS:
            raise self.error or httpx.RemoteProtocolError("the event stream keeps ending before the job does")
        return min(0.1 * 2.0**self._failures, MAX_PAUSE)
