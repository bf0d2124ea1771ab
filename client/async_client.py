"""The client of a running service for programs that use asyncio."""

from __future__ import annotations

from asyncio import sleep, to_thread
from collections.abc import AsyncIterator, Coroutine, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import httpx
from httpx_sse import aconnect_sse

from client import operations
from client.api_client import PATIENCE, TERMINAL, Event, authorization, checked_url
from client.client import url_of
from client.job import JobFields
from client.job_images import Images, opened
from client.reconnects import Reconnects
from client.request import Answer, Request, answer_of, refusal
from services import atomic_write

if TYPE_CHECKING:
    from PIL.Image import Image

    from client.answers import CampaignSummary, CampaignView, JobSpec, JobSummary, JobView, Priority, State, Uploaded


class AsyncJob(JobFields):
    """A job of a service; what asks the service is awaited."""

    def __init__(self, data: JobView, client: AsyncClient) -> None:
        super().__init__(data)
        self._client = client

    @cached_property
    def images(self) -> Images[Coroutine[None, None, Image]]:
        """The images before and after, each to be awaited: `await job.images.attacked`."""
        return Images(self._image)

    async def _image(self, name: str) -> Image:
        return opened(await self.file(name))

    async def file(self, name: str) -> bytes:
        """The bytes of one of the job's files."""
        return await self._client.call(operations.download_artifact(self.id, name))

    async def files(self) -> list[str]:
        """The names of the job's files; none until it has succeeded."""
        return [one["name"] for one in (await self._client.call(operations.list_artifacts(self.id)))["items"]]

    async def download(self, folder: Path | str) -> list[Path]:
        """Writes all files of the job into a folder, as `scene-attack run --out` does, and returns their paths."""
        paths = []
        for name in await self.files():
            path = Path(folder) / Path(name).name  # a service can name no file outside the folder
            await to_thread(atomic_write.write, path, await self.file(name))
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
        return await self.refresh() if self.ended and self.data["result"] is None else self

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


class AsyncClient:
    """As `Client`, for asyncio: `async with AsyncClient() as client: job = await client.submit_job(spec)`."""

    def __init__(
        self, url: str | None = None, *, key: str | None = None, transport: httpx.AsyncBaseTransport | None = None
    ) -> None:
        base, headers = checked_url(url_of(url)), authorization(key)
        self._http = httpx.AsyncClient(base_url=base, headers=headers, timeout=PATIENCE, transport=transport)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._http.aclose()

    async def call(self, request: Request[Answer]) -> Answer:
        """The answer to any request of `client.operations`."""
        found: Answer = answer_of(await self._http.request(**request.arguments()))
        return found

    async def stream_job_events(self, job_id: str, after: str | None = None) -> AsyncIterator[Event]:
        """A job's events, each once and in order, until it has ended; a dropped connection is taken up again."""
        reconnects = Reconnects()
        while True:
            asked = operations.stream_job_events(job_id, last_event_id=after).arguments()
            error: Exception | None = None
            try:
                async with aconnect_sse(self._http, **asked) as stream:
                    if stream.response.status_code == httpx.codes.NO_CONTENT:
                        return  # the job has ended, and all its events were received
                    if stream.response.status_code != httpx.codes.OK:
                        await stream.response.aread()
                        raise refusal(stream.response)
                    async for event in stream.aiter_sse():
                        reconnects.succeeded()
                        if not event.data:
                            continue  # a comment that keeps the connection alive
                        after = event.id
                        found = Event(event.id, event.event, event.json())
                        yield found
                        if found.kind == "state" and found.data["state"] in TERMINAL:
                            return
            except (httpx.TransportError, httpx.StreamError) as broken:
                error = broken
            await sleep(reconnects.pause(error))

    async def submit_job(self, spec: JobSpec | Mapping[str, Any], *, priority: Priority | None = None) -> AsyncJob:
        """Queues a job; ApiError with status 422 names every invalid field."""
        return AsyncJob(await self.call(operations.submit_job(spec, priority=priority)), self)

    async def get_job(self, job_id: str) -> AsyncJob:
        """One job by its id."""
        return AsyncJob(await self.call(operations.get_job(job_id)), self)

    async def list_jobs(
        self,
        *,
        q: str | None = None,
        sort: str | None = None,
        state: State | Sequence[State] | None = None,
        campaign: str | None = None,
    ) -> AsyncIterator[JobSummary]:
        """All jobs that meet a query such as "renderer:torch verified", newest first or sorted ("p", "-queries"), but
        without requests and results; asks for one page after the other.
        """
        cursor = None
        while True:
            page = await self.call(operations.list_jobs(q=q, sort=sort, state=state, campaign=campaign, cursor=cursor))
            for one in page["items"]:
                yield one
            cursor = page["next"]
            if cursor is None:
                return

    async def submit_campaign(self, spec: Mapping[str, Any], *, priority: Priority | None = None) -> CampaignView:
        """Starts a campaign."""
        return await self.call(operations.submit_campaign(spec, priority=priority))

    async def get_campaign(self, campaign_id: str) -> CampaignView:
        """One campaign, with its request, progress and outcomes."""
        return await self.call(operations.get_campaign(campaign_id))

    async def list_campaigns(self) -> AsyncIterator[CampaignSummary]:
        """All campaigns, newest first."""
        cursor = None
        while True:
            page = await self.call(operations.list_campaigns(cursor=cursor))
            for one in page["items"]:
                yield one
            cursor = page["next"]
            if cursor is None:
                return

    async def upload_asset(self, path: Path | str, kind: str | None = None, **about: str | None) -> Uploaded:
        """Uploads a mesh with the files beside it that it names, or an environment map, whose `name` goes into scenes.

        `kind` is its format, by default the file's ending; `about` has `mesh`, its name among several in a zip file,
        and what is said of it: `name`, `up`, `licence` and `credit`.
        """
        return await self.call(operations.upload_asset(Path(path), kind, **about))

    async def list_assets(self) -> list[Uploaded]:
        """The meshes that were uploaded."""
        return (await self.call(operations.list_assets()))["items"]

    async def delete_asset(self, name: str) -> None:
        """Deletes an uploaded mesh by its name. ApiError with status 409 while a job or campaign refers to it."""
        await self.call(operations.delete_asset(name))
