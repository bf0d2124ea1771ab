"""A client of a running service, for programs."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import httpx

from client import operations
from client.api_client import ApiClient
from client.job import Job
from client.request import Answer, Request

if TYPE_CHECKING:
    from client.answers import CampaignSummary, CampaignView, JobSpec, JobSummary, Priority, State, Uploaded

DEFAULT_URL = "http://127.0.0.1:8008"


def url_of(url: str | None) -> str:
    """The URL of the service: this one, or else that of SCENE_ATTACK_URL, or else of this machine."""
    return url or os.environ.get("SCENE_ATTACK_URL") or DEFAULT_URL


class Client:
    """Talks to the service at `url` (default: SCENE_ATTACK_URL, or this machine's) with `key` (SCENE_ATTACK_KEY).

    Raises InvalidRequest if URL or key cannot be one. Methods raise ApiError if the service refuses, and
    httpx.HTTPError if it does not answer. Close it after use: `with Client() as client: …`.
    """

    def __init__(
        self, url: str | None = None, *, key: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        self._api = ApiClient(url_of(url), key=key, transport=transport)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._api.__exit__(kind, error, trace)

    def call(self, request: Request[Answer]) -> Answer:
        """The typed answer to any request of `client.operations`: `client.call(operations.list_targets())["items"]`."""
        return self._api.call(request)

    def submit_job(self, spec: JobSpec | Mapping[str, Any], *, priority: Priority | None = None) -> Job:
        """Queues a job; ApiError with status 422 names every invalid field."""
        return Job(self.call(operations.submit_job(spec, priority=priority)), self._api)

    def get_job(self, job_id: str) -> Job:
        """One job by its id."""
        return Job(self.call(operations.get_job(job_id)), self._api)

    def list_jobs(
        self,
        *,
        q: str | None = None,
        sort: str | None = None,
        state: State | Sequence[State] | None = None,
        campaign: str | None = None,
    ) -> Iterator[JobSummary]:
        """All jobs that meet a query such as "renderer:torch verified", newest first or sorted ("p", "-queries"), but
        without requests and results; asks for one page after the other.
        """
        cursor = None
        while True:
            page = self.call(operations.list_jobs(q=q, sort=sort, state=state, campaign=campaign, cursor=cursor))
            yield from page["items"]
            cursor = page["next"]
            if cursor is None:
                return

    def submit_campaign(self, spec: Mapping[str, Any], *, priority: Priority | None = None) -> CampaignView:
        """Starts a campaign."""
        return self.call(operations.submit_campaign(spec, priority=priority))

    def get_campaign(self, campaign_id: str) -> CampaignView:
        """One campaign, with its request, progress and outcomes."""
        return self.call(operations.get_campaign(campaign_id))

    def list_campaigns(self) -> Iterator[CampaignSummary]:
        """All campaigns, newest first."""
        cursor = None
        while True:
            page = self.call(operations.list_campaigns(cursor=cursor))
            yield from page["items"]
            cursor = page["next"]
            if cursor is None:
                return

    def upload_asset(self, path: Path | str, kind: str | None = None, **about: str | None) -> Uploaded:
        """Uploads a mesh with the files beside it that it names, or an environment map, whose `name` goes into scenes.

        `kind` is its format, by default the file's ending; `about` has `mesh`, its name among several in a zip file,
        and what is said of it: `name`, `up`, `licence` and `credit`.
        """
        return self.call(operations.upload_asset(Path(path), kind, **about))

    def list_assets(self) -> list[Uploaded]:
        """The meshes that were uploaded."""
        return self.call(operations.list_assets())["items"]

    def delete_asset(self, name: str) -> None:
        """Deletes an uploaded mesh by its name. ApiError with status 409 while a job or campaign refers to it."""
        self.call(operations.delete_asset(name))
