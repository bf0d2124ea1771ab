"""The operations of the HTTP API: each function gives the request of one, with the type of its answer.

A client sends them: `client.call(operations.list_targets())`. A parameter that is None is left out of the request.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from client.campaign_operations import cancel_campaign as cancel_campaign
from client.campaign_operations import get_campaign as get_campaign
from client.campaign_operations import get_campaign_cases_csv as get_campaign_cases_csv
from client.campaign_operations import get_campaign_table as get_campaign_table
from client.campaign_operations import get_campaign_table_csv as get_campaign_table_csv
from client.campaign_operations import get_campaign_table_latex as get_campaign_table_latex
from client.campaign_operations import list_campaign_jobs as list_campaign_jobs
from client.campaign_operations import list_campaign_views as list_campaign_views
from client.campaign_operations import list_campaigns as list_campaigns
from client.campaign_operations import pause_campaign as pause_campaign
from client.campaign_operations import resume_campaign as resume_campaign
from client.campaign_operations import submit_campaign as submit_campaign
from client.request import CHECK_SECONDS, Device, Request

if TYPE_CHECKING:
    from client.answers import (
        ArtifactList,
        AssetList,
        Health,
        JobPage,
        JobSpec,
        JobTable,
        JobView,
        PreviewView,
        Priority,
        Readiness,
        RerenderingBody,
        SceneLibrary,
        State,
        TargetList,
        Uploaded,
    )


def submit_job(
    spec: JobSpec | Mapping[str, Any],
    *,
    priority: Priority | None = None,
    device: Device | None = None,
    memory: int | None = None,
    idempotency_key: str | None = None,
    wait: float | None = None,
) -> Request[JobView]:
    """Queues a job. `wait` is how many seconds the answer may wait for its end, at most 30; `memory` is in bytes."""
    return Request(
        "POST",
        "/v1/jobs",
        params={"priority": priority, "device": device, "memory": memory},
        headers={"Idempotency-Key": idempotency_key, "Prefer": None if wait is None else f"wait={wait:.0f}"},
        json=spec,
        seconds=CHECK_SECONDS,
    )


def list_jobs(
    *,
    q: str | None = None,
    sort: str | None = None,
    state: State | Sequence[State] | None = None,
    kind: Literal["attack", "rerendering"] | None = None,
    campaign: str | None = None,
    limit: int | None = None,
    cursor: str | None = None,
) -> Request[JobPage]:
    """A page of the jobs that meet a query such as "renderer:torch verified", newest first or in another order."""
    params = {
        "q": q,
        "sort": sort,
        "state": state,
        "kind": kind,
        "campaign": campaign,
        "limit": limit,
        "cursor": cursor,
    }
    return Request("GET", "/v1/jobs", params=params)


def get_job_table(*, q: str | None = None, sort: str | None = None, job: list[str] | None = None) -> Request[JobTable]:
    """Every job that meets a query, or those of the ids in `job`, as lines of a table."""
    return Request("GET", "/v1/jobs.json", params={"q": q, "sort": sort, "job": job})


def get_job_table_csv(*, q: str | None = None, sort: str | None = None, job: list[str] | None = None) -> Request[str]:
    """The table of `jobs_json` as CSV."""
    return Request("GET", "/v1/jobs.csv", params={"q": q, "sort": sort, "job": job})


def get_job(job_id: str) -> Request[JobView]:
    """One job, with its request and, when it has succeeded, its result."""
    return Request("GET", "/v1/jobs/{job_id}", {"job_id": job_id})


def edit_job(job_id: str, body: Mapping[str, Any]) -> Request[JobView]:
    """Changes a job's `title`, `tags` and `note`, those that `body` has."""
    return Request("PATCH", "/v1/jobs/{job_id}", {"job_id": job_id}, json=body)


def retry_job(job_id: str) -> Request[JobView]:
    """Queues a job's request again, as a new job."""
    return Request("POST", "/v1/jobs/{job_id}/retry", {"job_id": job_id})


def delete_job(job_id: str) -> Request[None]:
    """Deletes a job that has ended, with its files."""
    return Request("DELETE", "/v1/jobs/{job_id}", {"job_id": job_id})


def cancel_job(job_id: str) -> Request[JobView]:
    """Asks a job to stop; one that has ended stays as it is."""
    return Request("POST", "/v1/jobs/{job_id}/cancel", {"job_id": job_id})


def continue_job(job_id: str) -> Request[JobView]:
    """Queues a new job that goes on from the checkpoint of one that was cancelled or failed."""
    return Request("POST", "/v1/jobs/{job_id}/continue", {"job_id": job_id})


def stream_job_events(job_id: str, *, last_event_id: str | None = None) -> Request[bytes]:
    """A job's server-sent events after one of them; `Job.watch` reads them and takes up a dropped connection."""
    return Request("GET", "/v1/jobs/{job_id}/events", {"job_id": job_id}, headers={"Last-Event-ID": last_event_id})


def list_artifacts(job_id: str) -> Request[ArtifactList]:
    """The list of a finished job's files."""
    return Request("GET", "/v1/jobs/{job_id}/artifacts", {"job_id": job_id})


def download_artifact(job_id: str, name: str, *, if_none_match: str | None = None) -> Request[bytes]:
    """The bytes of one file of a job."""
    path, headers = {"job_id": job_id, "name": name}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/artifacts/{name}", path, headers=headers)


def download_export(job_id: str, *, if_none_match: str | None = None) -> Request[bytes]:
    """A zip file of a finished job: its scene before and after as glTF, maps, tables and a report."""
    path, headers = {"job_id": job_id}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/export", path, headers=headers, seconds=CHECK_SECONDS)


def download_scene(
    job_id: str, *, which: Literal["before", "after"] | None = None, if_none_match: str | None = None
) -> Request[bytes]:
    """A finished job's scene before or after the attack as a glb file."""
    path, headers = {"job_id": job_id}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/scene.glb", path, {"which": which}, headers, seconds=CHECK_SECONDS)


def preview_job(spec: JobSpec | Mapping[str, Any], *, plan: bool | None = None) -> Request[PreviewView]:
    """The picture of a request, what the network says of it, and on demand its plan, without an attack."""
    return Request("POST", "/v1/preview", params={"plan": plan}, json=spec, seconds=CHECK_SECONDS)


def rerender_image(
    body: RerenderingBody,
    *,
    priority: Priority | None = None,
    device: Device | None = None,
    memory: int | None = None,
    idempotency_key: str | None = None,
    wait: float | None = None,
) -> Request[JobView]:
    """Queues a job that renders the scene of an image again and asks the network about both; its `result` is a
    RerenderingView. The other arguments are those of `submit_job`.
    """
    return Request(
        "POST",
        "/v1/rerenderings",
        params={"priority": priority, "device": device, "memory": memory},
        headers={"Idempotency-Key": idempotency_key, "Prefer": None if wait is None else f"wait={wait:.0f}"},
        json=body,
        seconds=CHECK_SECONDS,
    )


def list_assets() -> Request[AssetList]:
    """The meshes that were uploaded."""
    return Request("GET", "/v1/assets")


def get_asset(name: str) -> Request[Uploaded]:
    """An uploaded mesh or environment map by its name, "sha256:" and 64 digits."""
    return Request("GET", "/v1/assets/{sha256}", {"sha256": name.removeprefix("sha256:")})


def download_thumbnail(name: str) -> Request[bytes]:
    """The picture of an upload, a PNG image."""
    return Request("GET", "/v1/assets/{sha256}/thumbnail", {"sha256": name.removeprefix("sha256:")})


def upload_asset(
    path: Path,
    kind: str | None = None,
    *,
    mesh: str | None = None,
    name: str | None = None,
    up: str | None = None,
    licence: str | None = None,
    credit: str | None = None,
) -> Request[Uploaded]:
    """Uploads a mesh with the files beside it that it names, a zip file of them, or an environment map.

    `kind` is the format, by default the file's ending; `mesh` names the mesh among several in a zip file. Raises
    InvalidRequest if there is no such file.
    """
    from client.mesh_files import with_files_beside

    files = [(sent, one.read_bytes()) for sent, one in with_files_beside([path])]
    form = {"kind": kind, "mesh": mesh, "name": name, "up": up, "licence": licence, "credit": credit}
    return Request("POST", "/v1/assets", files=files, form=form, seconds=CHECK_SECONDS)


def delete_asset(name: str) -> Request[None]:
    """Deletes an uploaded mesh by its name, "sha256:" and 64 digits."""
    return Request("DELETE", "/v1/assets/{sha256}", {"sha256": name.removeprefix("sha256:")})


def get_scene_library(
    *, category: str | None = None, creator: str | None = None, licence: str | None = None, search: str | None = None
) -> Request[SceneLibrary]:
    """The meshes that match, and all environment maps."""
    params = {"category": category, "creator": creator, "licence": licence, "search": search}
    return Request("GET", "/v1/scenes", params=params)


def list_targets() -> Request[TargetList]:
    """The networks that can be attacked."""
    return Request("GET", "/v1/targets")


def get_health() -> Request[Health]:
    """Whether the process answers."""
    return Request("GET", "/healthz")


def get_readiness() -> Request[Readiness]:
    """Whether the service can take jobs and run them; ApiError with status 503 if it cannot."""
    return Request("GET", "/readyz")


def get_metrics() -> Request[str]:
    """The metrics, in Prometheus' text format."""
    return Request("GET", "/metrics")
