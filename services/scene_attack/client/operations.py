"""The operations of the HTTP API: each function returns the request of one, with the model of its answer.

This is the table of openapi.yaml's operations: method, path, parameters and models. A client sends a request and reads
its answer: `client.call(operations.list_targets()).items`. A parameter that is None is left out of the request. The
models are those with which the service makes its answers; fields that a newer service adds are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypedDict, TypeVar, Unpack
from urllib.parse import quote

from pydantic import BaseModel

from scene_attack.client.schemas import (
    ArtifactList,
    AssetList,
    CampaignJobPage,
    CampaignPage,
    CampaignView,
    Health,
    JobEdit,
    JobPage,
    JobTable,
    JobView,
    PreviewView,
    Readiness,
    RerenderingBody,
    SceneLibrary,
    TargetList,
    Uploaded,
    ViewList,
)
from scene_attack.client.states import CampaignState, Priority, State
from scene_attack.runs.campaign_plan import CampaignResult
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.spec import JobSpec

Answer = TypeVar("Answer")
Device = Literal["cuda", "cpu"]
PriorityName = Priority | Literal["high", "normal", "low"]
StateName = State | Literal["queued", "running", "cancelling", "succeeded", "failed", "rejected", "cancelled"]
CampaignStateName = CampaignState | Literal["selecting", "running", "paused", "finished", "cancelled"]
CHECK_SECONDS = 300.0
"""Longest time in seconds for the check of a request; the first one waits for a process to warm up."""


@dataclass(frozen=True)
class Request(Generic[Answer]):
    """A request of an operation of openapi.yaml before it is sent.

    `route` is its path there, whose names in braces are in `path`. `answer` is the model of the answer; `bytes` or
    `str` for a file or a text, and the type of None where there is no content.
    """

    method: str
    route: str
    answer: type[Answer]
    path: Mapping[str, str] = field(default_factory=dict)
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str | None] = field(default_factory=dict)
    json: BaseModel | Mapping[str, Any] | None = None
    files: Sequence[tuple[str, bytes]] = ()
    form: Mapping[str, Any] = field(default_factory=dict)
    seconds: float | None = None
    """Longest wait for the answer; None for the client's own."""

    @property
    def address(self) -> str:
        """The path with its names filled in."""
        return self.route.format_map({name: quote(value, safe="") for name, value in self.path.items()})

    def arguments(self) -> dict[str, Any]:
        """The request as the arguments of `httpx.Client.request`."""
        arguments: dict[str, Any] = {"method": self.method, "url": self.address}
        if params := _given(self.params):
            arguments["params"] = params
        if headers := _given(self.headers):
            arguments["headers"] = headers
        if self.json is not None:
            arguments["json"] = _plain(self.json)
        if self.files:
            arguments |= {"files": [("file", file) for file in self.files], "data": _given(self.form)}
        if self.seconds is not None:
            arguments["timeout"] = self.seconds
        return arguments


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _plain(body: BaseModel | Mapping[str, Any]) -> Any:
    if not isinstance(body, BaseModel):
        return body
    # An edit leaves the fields alone that were not given; every other body may have its defaults spelt out.
    return body.model_dump(mode="json", exclude_unset=isinstance(body, JobEdit))


def _check_names(given: Mapping[str, Any], known: type) -> None:
    for name in given:
        if name not in known.__annotations__:
            raise TypeError(f"there is no argument {name!r}; there are {', '.join(known.__annotations__)}")


def _of_service(route: str, answer: type[Answer]) -> Callable[[], Request[Answer]]:
    """An operation that takes nothing."""
    return lambda: Request("GET", route, answer)


def _of_job(method: str, route: str, answer: type[Answer]) -> Callable[[str], Request[Answer]]:
    """An operation on the job with an id; `route` is what follows the job's own path."""
    return lambda job_id: Request(method, "/v1/jobs/{job_id}" + route, answer, {"job_id": job_id})


def _of_campaign(method: str, route: str, answer: type[Answer]) -> Callable[[str], Request[Answer]]:
    """An operation on the campaign with an id."""
    return lambda campaign_id: Request(
        method, "/v1/campaigns/{campaign_id}" + route, answer, {"campaign_id": campaign_id}
    )


def _of_asset(method: str, route: str, answer: type[Answer]) -> Callable[[str], Request[Answer]]:
    """An operation on an upload by its name, "sha256:" and 64 digits, or by the digits alone."""
    return lambda name: Request(method, "/v1/assets/{sha256}" + route, answer, {"sha256": name.removeprefix("sha256:")})


class Submission(TypedDict, total=False):
    """What a submission asks for: `device` and `memory`, in bytes, are those that a worker must have."""

    priority: PriorityName | None
    device: Device | None
    memory: int | None
    idempotency_key: str | None


def _submission(
    route: str,
    answer: type[Answer],
    body: BaseModel | Mapping[str, Any],
    asked: Submission,
    headers: Mapping[str, str | None],
) -> Request[Answer]:
    _check_names(asked, Submission)
    params = {name: asked.get(name) for name in ("priority", "device", "memory")}
    headers = {"Idempotency-Key": asked.get("idempotency_key"), **headers}
    return Request("POST", route, answer, params=params, headers=headers, json=body, seconds=CHECK_SECONDS)


def _prefer(wait: float | None) -> dict[str, str | None]:
    return {"Prefer": None if wait is None else f"wait={wait:.0f}"}


def submit_job(
    spec: JobSpec | Mapping[str, Any], *, wait: float | None = None, **asked: Unpack[Submission]
) -> Request[JobView]:
    """Queues a job. `wait` is how many seconds the answer may wait for its end, at most 30."""
    return _submission("/v1/jobs", JobView, spec, asked, _prefer(wait))


class JobFilter(TypedDict, total=False):
    """Which jobs to list, and in which order: `q` is a query such as "renderer:torch verified", `sort` a column such as
    "p", or "-queries" for the greatest first.
    """

    q: str | None
    sort: str | None
    state: StateName | Sequence[StateName] | None
    kind: Literal["attack", "rerendering"] | None
    campaign: str | None


def list_jobs(*, limit: int | None = None, cursor: str | None = None, **which: Unpack[JobFilter]) -> Request[JobPage]:
    """A page of the jobs that meet a query, newest first or in another order."""
    _check_names(which, JobFilter)
    filters = {name: which.get(name) for name in JobFilter.__annotations__}
    return Request("GET", "/v1/jobs", JobPage, params=filters | {"limit": limit, "cursor": cursor})


def get_job_table(*, q: str | None = None, sort: str | None = None, job: list[str] | None = None) -> Request[JobTable]:
    """Every job that meets a query, or those of the ids in `job`, as lines of a table."""
    return Request("GET", "/v1/jobs.json", JobTable, params={"q": q, "sort": sort, "job": job})


def get_job_table_csv(*, q: str | None = None, sort: str | None = None, job: list[str] | None = None) -> Request[str]:
    """The table of `get_job_table` as CSV."""
    return Request("GET", "/v1/jobs.csv", str, params={"q": q, "sort": sort, "job": job})


get_job = _of_job("GET", "", JobView)
"""One job, with its request and, when it has succeeded, its result."""


def edit_job(job_id: str, body: JobEdit | Mapping[str, Any]) -> Request[JobView]:
    """Changes a job's `title`, `tags` and `note`, those that `body` has."""
    return Request("PATCH", "/v1/jobs/{job_id}", JobView, {"job_id": job_id}, json=body)


retry_job = _of_job("POST", "/retry", JobView)
"""Queues a job's request again, as a new job."""
delete_job = _of_job("DELETE", "", type(None))
"""Deletes a job that has ended, with its files."""
cancel_job = _of_job("POST", "/cancel", JobView)
"""Asks a job to stop; one that has ended stays as it is."""
continue_job = _of_job("POST", "/continue", JobView)
"""Queues a new job that goes on from the checkpoint of one that was cancelled or failed."""


def stream_job_events(job_id: str, *, last_event_id: str | None = None) -> Request[bytes]:
    """A job's server-sent events after one of them; `Job.watch` reads them and takes up a dropped connection."""
    return Request(
        "GET", "/v1/jobs/{job_id}/events", bytes, {"job_id": job_id}, headers={"Last-Event-ID": last_event_id}
    )


list_artifacts = _of_job("GET", "/artifacts", ArtifactList)
"""The list of a finished job's files."""


def download_artifact(job_id: str, name: str, *, if_none_match: str | None = None) -> Request[bytes]:
    """The bytes of one file of a job."""
    path, headers = {"job_id": job_id, "name": name}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/artifacts/{name}", bytes, path, headers=headers)


def download_export(job_id: str, *, if_none_match: str | None = None) -> Request[bytes]:
    """A zip file of a finished job: its scene before and after as glTF, maps, tables and a report."""
    path, headers = {"job_id": job_id}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/export", bytes, path, headers=headers, seconds=CHECK_SECONDS)


def download_scene(
    job_id: str, *, which: Literal["before", "after"] | None = None, if_none_match: str | None = None
) -> Request[bytes]:
    """A finished job's scene before or after the attack as a glb file."""
    path, headers = {"job_id": job_id}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/scene.glb", bytes, path, {"which": which}, headers, seconds=CHECK_SECONDS)


def preview_job(spec: JobSpec | Mapping[str, Any], *, plan: bool | None = None) -> Request[PreviewView]:
    """The picture of a request, what the network says of it, and on demand its plan, without an attack."""
    return Request("POST", "/v1/preview", PreviewView, params={"plan": plan}, json=spec, seconds=CHECK_SECONDS)


def rerender_image(
    body: RerenderingBody | Mapping[str, Any], *, wait: float | None = None, **asked: Unpack[Submission]
) -> Request[JobView]:
    """Queues a job that renders the scene of an image again and asks the network about both; its `result` is a
    RerenderingView. The other arguments are those of `submit_job`.
    """
    return _submission("/v1/rerenderings", JobView, body, asked, _prefer(wait))


def submit_campaign(spec: CampaignSpec | Mapping[str, Any], **asked: Unpack[Submission]) -> Request[CampaignView]:
    """Starts a campaign; priority, device and memory are those of its jobs."""
    return _submission("/v1/campaigns", CampaignView, spec, asked, {})


def list_campaigns(
    *, state: CampaignStateName | None = None, limit: int | None = None, cursor: str | None = None
) -> Request[CampaignPage]:
    """A page of the campaigns, newest first."""
    return Request("GET", "/v1/campaigns", CampaignPage, params={"state": state, "limit": limit, "cursor": cursor})


get_campaign = _of_campaign("GET", "", CampaignView)
"""One campaign, with its request, progress and outcomes."""
pause_campaign = _of_campaign("POST", "/pause", CampaignView)
"""Holds a campaign's queued jobs back."""
resume_campaign = _of_campaign("POST", "/resume", CampaignView)
"""Lets a paused campaign go on."""
cancel_campaign = _of_campaign("POST", "/cancel", CampaignView)
"""Ends a campaign and its jobs."""
list_campaign_views = _of_campaign("GET", "/views", ViewList)
"""The views of a campaign with the networks' first answers, and why some are not attacked."""


def list_campaign_jobs(
    campaign_id: str, *, limit: int | None = None, after: int | None = None
) -> Request[CampaignJobPage]:
    """A page of a campaign's planned jobs, with numbers above `after`."""
    path, params = {"campaign_id": campaign_id}, {"limit": limit, "after": after}
    return Request("GET", "/v1/campaigns/{campaign_id}/jobs", CampaignJobPage, path, params)


get_campaign_table = _of_campaign("GET", "/table.json", CampaignResult)
"""The table, the mean curves and the views of a campaign."""
get_campaign_table_csv = _of_campaign("GET", "/table.csv", str)
"""The table of a campaign as CSV."""
get_campaign_table_latex = _of_campaign("GET", "/table.tex", str)
"""The table of a campaign as LaTeX."""
get_campaign_cases_csv = _of_campaign("GET", "/cases.csv", str)
"""The jobs of a campaign that have ended, as CSV."""
list_assets = _of_service("/v1/assets", AssetList)
"""The meshes that were uploaded."""
get_asset = _of_asset("GET", "", Uploaded)
"""An uploaded mesh or environment map by its name, "sha256:" and 64 digits."""
download_thumbnail = _of_asset("GET", "/thumbnail", bytes)
"""The picture of an upload, a PNG image."""


def upload_asset(
    files: Sequence[Path | tuple[str, bytes]],
    kind: str | None = None,
    *,
    mesh: str | None = None,
    name: str | None = None,
    up: str | None = None,
    licence: str | None = None,
    credit: str | None = None,
) -> Request[Uploaded]:
    """Uploads a mesh with the files beside it that it names, a zip file of them, or an environment map.

    `kind` is the format, by default the file's ending; `mesh` names the mesh among several files. A file that is given
    alone is the mesh. In a path's place may be a name and bytes. Raises InvalidRequest if there is no such file.
    """
    from scene_attack.client.mesh_files import with_files_beside

    paths = [file for file in files if isinstance(file, Path)]
    sent = [(sent, path.read_bytes()) for sent, path in (with_files_beside(paths) if paths else ())]
    if mesh is None and len(paths) == 1 < len(sent):
        mesh = paths[0].name
    sent += [file for file in files if not isinstance(file, Path)]
    form = {"kind": kind, "mesh": mesh, "name": name, "up": up, "licence": licence, "credit": credit}
    return Request("POST", "/v1/assets", Uploaded, files=sent, form=form, seconds=CHECK_SECONDS)


delete_asset = _of_asset("DELETE", "", type(None))
"""Deletes an uploaded mesh by its name, "sha256:" and 64 digits."""


def get_scene_library(
    *, category: str | None = None, creator: str | None = None, licence: str | None = None, search: str | None = None
) -> Request[SceneLibrary]:
    """The meshes that match, and all environment maps."""
    params = {"category": category, "creator": creator, "licence": licence, "search": search}
    return Request("GET", "/v1/scenes", SceneLibrary, params=params)


list_targets = _of_service("/v1/targets", TargetList)
"""The networks that can be attacked."""
get_health = _of_service("/healthz", Health)
"""Whether the process answers."""
get_readiness = _of_service("/readyz", Readiness)
"""Whether the service can take jobs and run them; ApiError with status 503 if it cannot."""
get_metrics = _of_service("/metrics", str)
"""The metrics, in Prometheus' text format."""
