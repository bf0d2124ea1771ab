"""The operations of the HTTP API: each function gives the request of one, with the type of its answer.

A client sends them: `client.call(operations.targets())`. A parameter that is None is left out of the request.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from client.request import Request

if TYPE_CHECKING:
    from client.answers import (
        ArtifactList,
        AssetList,
        CampaignJobPage,
        CampaignPage,
        CampaignResult,
        CampaignSpec,
        CampaignState,
        CampaignView,
        DeliveryList,
        Entry,
        Health,
        JobPage,
        JobSpec,
        JobTable,
        JobView,
        NewWebhook,
        PreviewView,
        Priority,
        Readiness,
        RerenderingBody,
        RerenderingView,
        SceneLibrary,
        State,
        TargetList,
        ViewList,
        WebhookList,
    )

CHECK_SECONDS = 300.0
"""The service may take so long to check a request; the first request waits for a process to warm up."""
Device = Literal["cuda", "cpu"]


def submit(
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


def jobs(
    *,
    q: str | None = None,
    sort: str | None = None,
    state: State | None = None,
    campaign: str | None = None,
    limit: int | None = None,
    cursor: str | None = None,
) -> Request[JobPage]:
    """A page of the jobs that meet a query such as "renderer:torch verified", newest first or in another order."""
    params = {"q": q, "sort": sort, "state": state, "campaign": campaign, "limit": limit, "cursor": cursor}
    return Request("GET", "/v1/jobs", params=params)


def jobs_json(*, q: str | None = None, sort: str | None = None, job: list[str] | None = None) -> Request[JobTable]:
    """Every job that meets a query, or those of the ids in `job`, as lines of a table."""
    return Request("GET", "/v1/jobs.json", params={"q": q, "sort": sort, "job": job})


def jobs_csv(*, q: str | None = None, sort: str | None = None, job: list[str] | None = None) -> Request[str]:
    """The table of `jobs_json` as CSV."""
    return Request("GET", "/v1/jobs.csv", params={"q": q, "sort": sort, "job": job})


def job(job_id: str) -> Request[JobView]:
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


def events(job_id: str, *, last_event_id: str | None = None) -> Request[bytes]:
    """A job's server-sent events after one of them; `Job.watch` reads them and takes up a dropped connection."""
    return Request("GET", "/v1/jobs/{job_id}/events", {"job_id": job_id}, headers={"Last-Event-ID": last_event_id})


def artifacts(job_id: str) -> Request[ArtifactList]:
    """The list of a finished job's files."""
    return Request("GET", "/v1/jobs/{job_id}/artifacts", {"job_id": job_id})


def artifact(job_id: str, name: str, *, if_none_match: str | None = None) -> Request[bytes]:
    """The bytes of one file of a job."""
    path, headers = {"job_id": job_id, "name": name}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/artifacts/{name}", path, headers=headers)


def export(job_id: str, *, if_none_match: str | None = None) -> Request[bytes]:
    """A zip file of a finished job: its scene before and after as glTF, maps, tables and a report."""
    path, headers = {"job_id": job_id}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/export", path, headers=headers, seconds=CHECK_SECONDS)


def scene(
    job_id: str, *, which: Literal["before", "after"] | None = None, if_none_match: str | None = None
) -> Request[bytes]:
    """A finished job's scene before or after the attack as a glb file."""
    path, headers = {"job_id": job_id}, {"If-None-Match": if_none_match}
    return Request("GET", "/v1/jobs/{job_id}/scene.glb", path, {"which": which}, headers, seconds=CHECK_SECONDS)


def preview(spec: JobSpec | Mapping[str, Any], *, plan: bool | None = None) -> Request[PreviewView]:
    """The picture of a request, what the network says of it, and its plan, without an attack."""
    return Request("POST", "/v1/preview", params={"plan": plan}, json=spec, seconds=CHECK_SECONDS)


def cases_csv(campaign_id: str) -> Request[str]:
    """The jobs of a campaign that have ended, as CSV."""
    return Request("GET", "/v1/campaigns/{campaign_id}/cases.csv", {"campaign_id": campaign_id})


def rerender(body: RerenderingBody) -> Request[RerenderingView]:
    """Renders the scene of an image again and asks the network about both; takes up to five minutes."""
    return Request("POST", "/v1/rerenderings", json=body, seconds=CHECK_SECONDS)


def submit_campaign(
    spec: CampaignSpec | Mapping[str, Any],
    *,
    priority: Priority | None = None,
    device: Device | None = None,
    memory: int | None = None,
    idempotency_key: str | None = None,
) -> Request[CampaignView]:
    """Starts a campaign; priority, device and memory are those of its jobs."""
    return Request(
        "POST",
        "/v1/campaigns",
        params={"priority": priority, "device": device, "memory": memory},
        headers={"Idempotency-Key": idempotency_key},
        json=spec,
        seconds=CHECK_SECONDS,
    )


def campaigns(
    *, state: CampaignState | None = None, limit: int | None = None, cursor: str | None = None
) -> Request[CampaignPage]:
    """A page of the campaigns, newest first."""
    return Request("GET", "/v1/campaigns", params={"state": state, "limit": limit, "cursor": cursor})


def campaign(campaign_id: str) -> Request[CampaignView]:
    """One campaign, with its request, progress and outcomes."""
    return Request("GET", "/v1/campaigns/{campaign_id}", {"campaign_id": campaign_id})


def pause_campaign(campaign_id: str) -> Request[CampaignView]:
    """Holds a campaign's queued jobs back."""
    return Request("POST", "/v1/campaigns/{campaign_id}/pause", {"campaign_id": campaign_id})


def resume_campaign(campaign_id: str) -> Request[CampaignView]:
    """Lets a paused campaign go on."""
    return Request("POST", "/v1/campaigns/{campaign_id}/resume", {"campaign_id": campaign_id})


def cancel_campaign(campaign_id: str) -> Request[CampaignView]:
    """Ends a campaign and its jobs."""
    return Request("POST", "/v1/campaigns/{campaign_id}/cancel", {"campaign_id": campaign_id})


def campaign_views(campaign_id: str) -> Request[ViewList]:
    """The views of a campaign with the networks' first answers, and why some are not attacked."""
    return Request("GET", "/v1/campaigns/{campaign_id}/views", {"campaign_id": campaign_id})


def campaign_jobs(campaign_id: str, *, limit: int | None = None, after: int | None = None) -> Request[CampaignJobPage]:
    """A page of a campaign's planned jobs, with numbers above `after`."""
    path, params = {"campaign_id": campaign_id}, {"limit": limit, "after": after}
    return Request("GET", "/v1/campaigns/{campaign_id}/jobs", path, params)


def campaign_table(campaign_id: str) -> Request[CampaignResult]:
    """The table, the mean curves and the views of a campaign."""
    return Request("GET", "/v1/campaigns/{campaign_id}/table.json", {"campaign_id": campaign_id})


def campaign_table_csv(campaign_id: str) -> Request[str]:
    """The table of a campaign as CSV."""
    return Request("GET", "/v1/campaigns/{campaign_id}/table.csv", {"campaign_id": campaign_id})


def campaign_table_latex(campaign_id: str) -> Request[str]:
    """The table of a campaign as LaTeX."""
    return Request("GET", "/v1/campaigns/{campaign_id}/table.tex", {"campaign_id": campaign_id})


def assets() -> Request[AssetList]:
    """The meshes that were uploaded."""
    return Request("GET", "/v1/assets")


def asset(name: str) -> Request[Entry]:
    """An uploaded mesh or environment map by its name, "sha256:" and 64 digits."""
    return Request("GET", "/v1/assets/{sha256}", {"sha256": name.removeprefix("sha256:")})


def add_asset(
    path: Path,
    kind: str | None = None,
    *,
    mesh: str | None = None,
    name: str | None = None,
    up: str | None = None,
    licence: str | None = None,
    credit: str | None = None,
) -> Request[Entry]:
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


def scenes(
    *, category: str | None = None, creator: str | None = None, licence: str | None = None, search: str | None = None
) -> Request[SceneLibrary]:
    """The meshes that match, and all environment maps."""
    params = {"category": category, "creator": creator, "licence": licence, "search": search}
    return Request("GET", "/v1/scenes", params=params)


def targets() -> Request[TargetList]:
    """The networks that can be attacked."""
    return Request("GET", "/v1/targets")


def webhooks() -> Request[WebhookList]:
    """The webhooks of the caller."""
    return Request("GET", "/v1/webhooks")


def add_webhook(url: str) -> Request[NewWebhook]:
    """Registers a URL that is told when jobs and campaigns end. The answer's `secret` is shown this once."""
    return Request("POST", "/v1/webhooks", json={"url": url})


def delete_webhook(webhook_id: str) -> Request[None]:
    """Deletes a webhook."""
    return Request("DELETE", "/v1/webhooks/{webhook_id}", {"webhook_id": webhook_id})


def deliveries(webhook_id: str) -> Request[DeliveryList]:
    """The last hundred messages of a webhook."""
    return Request("GET", "/v1/webhooks/{webhook_id}/deliveries", {"webhook_id": webhook_id})


def health() -> Request[Health]:
    """Whether the process answers."""
    return Request("GET", "/healthz")


def readiness() -> Request[Readiness]:
    """Whether the service can take jobs and run them; ApiError with status 503 if it cannot."""
    return Request("GET", "/readyz")


def metrics() -> Request[str]:
    """The metrics, in Prometheus' text format."""
    return Request("GET", "/metrics")
