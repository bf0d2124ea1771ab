"""A client of the service's HTTP API."""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from time import sleep
from types import TracebackType
from typing import Any, Self

import httpx
from httpx_sse import connect_sse

from client import operations
from client.reconnects import Reconnects
from client.request import Answer, ApiError, Request, answer_of, object_of, refusal
from services import atomic_write
from services.errors import InvalidRequest

__all__ = ["ApiClient", "ApiError", "Event"]

TERMINAL = ("succeeded", "failed", "rejected", "cancelled")
PATIENCE = 30.0
"""Seconds without a byte after which an event stream counts as dropped; the service sends a comment more often."""
PAGE = 200
"""Jobs that are asked for at once."""
_CHECK = 300.0
"""Seconds that the service may take to check a request; the first request waits for a process to warm up."""


@dataclass(frozen=True)
class Event:
    """An event of a job: its number, its kind ("state" or "progress") and its data."""

    number: str
    kind: str
    data: dict[str, Any]


def checked_url(url: str) -> str:
    """The URL of a service. Raises InvalidRequest if it cannot be one."""
    if not re.match(r"https?://[^/]", url):
        raise InvalidRequest("--url", f"{url!r} is no address of a service, such as http://127.0.0.1:8008")
    if found := re.match(r"(.*?)/v1(/|$)", url):
        raise InvalidRequest("--url", f"{url!r} has /v1, which is added to the address: give {found[1]}")
    return url


def authorization(key: str | None) -> dict[str, str]:
    """The headers that send a key: this one, or the one in SCENE_ATTACK_KEY, if there is one."""
    key = (os.environ.get("SCENE_ATTACK_KEY", "") if key is None else key).strip()
    if not key.isascii() or not key.isprintable():
        raise InvalidRequest("SCENE_ATTACK_KEY", "is no key of this service: those are ASCII and begin with sa_")
    return {"Authorization": f"Bearer {key}"} if key else {}


class ApiClient:
    """Calls the service at a URL, with a key, that in SCENE_ATTACK_KEY if none is given. Redirects are not followed, so
    that the key goes nowhere else.

    Raises InvalidRequest if URL or key cannot be one. Methods raise ApiError if the service refuses, and
    httpx.HTTPError if it does not answer.
    """

    def __init__(self, url: str, *, key: str | None = None, transport: httpx.BaseTransport | None = None) -> None:
        self._http = httpx.Client(
            base_url=checked_url(url), headers=authorization(key), timeout=PATIENCE, transport=transport
        )

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
        """The answer to a request of `client.operations`."""
        found: Answer = answer_of(self._http.request(**request.arguments()))
        return found

    def submit_job(self, spec: Mapping[str, Any], priority: str | None = None) -> dict[str, Any]:
        """Queues a job and returns it; `priority` is high, normal or low."""
        return self._json(self._http.post("/v1/jobs", json=spec, params=_given(priority=priority), timeout=_CHECK))

    def get_job(self, job_id: str) -> dict[str, Any]:
        """One job, with its spec, state and, when it has succeeded, its result."""
        return self._json(self._http.get(f"/v1/jobs/{job_id}"))

    def list_jobs(
        self,
        limit: int = 20,
        state: str | None = None,
        cursor: str | None = None,
        q: str | None = None,
        sort: str | None = None,
    ) -> dict[str, Any]:
        """A page of the jobs that meet a query: {"items": […], "next": cursor or null, "previous": likewise}."""
        given = _given(limit=limit, state=state, cursor=cursor, q=q, sort=sort)
        return self._json(self._http.get("/v1/jobs", params=given))

    def all_jobs(self, **asked: str | list[str] | None) -> Iterator[dict[str, Any]]:
        """All jobs that meet `state`, `campaign` and `q`, in the order `sort`, in as many requests as are needed."""
        cursor = None
        while True:
            page = self._json(self._http.get("/v1/jobs", params=_given(limit=PAGE, cursor=cursor, **asked)))
            yield from page["items"]
            cursor = page["next"]
            if cursor is None:
                return

    def cancel_job(self, job_id: str) -> dict[str, Any]:
        """Asks a job to stop and returns it; has no effect on a job that has ended."""
        return self._json(self._http.post(f"/v1/jobs/{job_id}/cancel"))

    def delete_job(self, job_id: str) -> None:
        """Deletes a job that has ended."""
        response = self._http.delete(f"/v1/jobs/{job_id}")
        if response.is_error:
            raise refusal(response)

    def stream_job_events(self, job_id: str, after: str | None = None) -> Iterator[Event]:
        """The job's events, each once and in order, until it has ended; a dropped connection is taken up again."""
        reconnects = Reconnects()
        while True:
            error: Exception | None = None
            headers = {} if after is None else {"Last-Event-ID": after}
            try:
                with connect_sse(self._http, "GET", f"/v1/jobs/{job_id}/events", headers=headers) as stream:
                    if stream.response.status_code == httpx.codes.NO_CONTENT:
                        return  # the job has ended, and all its events were received
                    if stream.response.status_code != httpx.codes.OK:
                        stream.response.read()
                        raise refusal(stream.response)
                    for event in stream.iter_sse():
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
            sleep(reconnects.pause(error))

    def list_artifacts(self, job_id: str) -> list[dict[str, Any]]:
        """The files of a finished job: name, sha256, media type, size."""
        return list(self._json(self._http.get(f"/v1/jobs/{job_id}/artifacts"))["items"])

    def download_artifact(self, job_id: str, name: str, to: Path) -> None:
        """Writes one artifact to the file `to`, which appears only when it is complete."""
        self._save(operations.download_artifact(job_id, name), to)

    def download_export(self, job_id: str, to: Path) -> None:
        """Writes the zip file of a finished job's export to `to`, which appears only when it is complete."""
        self._save(operations.download_export(job_id), to)

    def _save(self, request: Request[bytes], to: Path) -> None:
        with self._http.stream(**request.arguments()) as response:
            if response.status_code != httpx.codes.OK:
                response.read()
                raise refusal(response)
            with atomic_write.replacing(to) as part, part.open("wb") as file:
                for chunk in response.iter_bytes():
                    file.write(chunk)

    def upload_asset(
        self, files: Sequence[tuple[str, Path]], kind: str | None = None, mesh: str | None = None, **about: str | None
    ) -> dict[str, Any]:
        """Uploads a mesh and returns its library entry.

        `files` are the mesh and the files that it names, each with its relative path, or one zip file; `mesh` is the
        name of the mesh among several, and `kind` its format, by default the ending of its name. `about` has what is
        said of it: name, up, licence and credit.
        """
        with ExitStack() as stack:
            parts = [("file", (name, stack.enter_context(path.open("rb")))) for name, path in files]
            data = _given(kind=kind, mesh=mesh, **about)
            return self._json(self._http.post("/v1/assets", files=parts, data=data, timeout=_CHECK))

    def list_assets(self) -> list[dict[str, Any]]:
        """The library entries of the meshes that were uploaded."""
        return list(self._json(self._http.get("/v1/assets"))["items"])

    def delete_asset(self, name: str) -> None:
        """Deletes an uploaded mesh by its name, "sha256:" and 64 digits."""
        response = self._http.delete(f"/v1/assets/{name.removeprefix('sha256:')}")
        if response.is_error:
            raise refusal(response)

    def submit_campaign(self, spec: Mapping[str, Any], priority: str | None = None) -> dict[str, Any]:
        """Starts a campaign and returns it; `priority` is that of its jobs: high, normal or low."""
        given = _given(priority=priority)
        return self._json(self._http.post("/v1/campaigns", json=spec, params=given, timeout=_CHECK))

    def get_campaign(self, campaign_id: str) -> dict[str, Any]:
        """One campaign, with its request, progress and outcomes."""
        return self._json(self._http.get(f"/v1/campaigns/{campaign_id}"))

    def list_campaigns(self, limit: int = 20, cursor: str | None = None) -> dict[str, Any]:
        """A page of campaigns, newest first."""
        return self._json(self._http.get("/v1/campaigns", params=_given(limit=limit, cursor=cursor)))

    def get_campaign_table(self, campaign_id: str) -> dict[str, Any]:
        """The table, the mean curves and the views of a campaign."""
        return self._json(self._http.get(f"/v1/campaigns/{campaign_id}/table.json"))

    def list_campaign_jobs(self, campaign_id: str, after: int = -1) -> dict[str, Any]:
        """A page of a campaign's planned jobs, with numbers above `after`."""
        return self._json(self._http.get(f"/v1/campaigns/{campaign_id}/jobs", params={"after": after}))

    def ready(self) -> bool:
        """Whether the service has a database, a queue and a worker."""
        try:
            return self._http.get("/readyz").status_code == httpx.codes.OK
        except httpx.TransportError:
            return False

    def _json(self, response: httpx.Response) -> dict[str, Any]:
        return object_of(response)


def _given(**values: str | int | list[str] | None) -> dict[str, str | int | list[str]]:
    """The query parameters that were given."""
    return {name: value for name, value in values.items() if value is not None}
