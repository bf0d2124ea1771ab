"""Routes of the pages of jobs. A script keeps the pages up to date; they also work without it."""

import json
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse

from api.access.authentication import CallerDependency
from api.dashboard import views
from api.dashboard.commands import commands
from api.dashboard.job_about import about
from api.dashboard.pages import HEADERS, STATIC, VERSION, html
from api.dashboard.views import all_events
from api.routes.jobs import continued
from api.state import KnownJob, Services, ServicesDependency, no_such
from services.access.caller import Caller
from services.jobs.files import Damaged
from services.jobs.models import Artifact, JobKind
from services.pipeline.result import BEST_SO_FAR

_KINDS = {"css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
"""Media types by the end of a name; anything else is text, as licences are."""

router = APIRouter(include_in_schema=False)


@router.get("/jobs/{job_id}")
def job(job_id: str, services: ServicesDependency, caller: CallerDependency, request: Request) -> Response:
    """The page of one job."""
    return _job("", job_id, services, caller, request)


@router.get("/parts/jobs/{job_id}")
def job_part(job_id: str, services: ServicesDependency, caller: CallerDependency, request: Request) -> Response:
    """The part of a job's page that the script reloads."""
    return _job("_", job_id, services, caller, request)


@router.post("/jobs/{job_id}/cancel")
def cancel(job_id: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Cancels a job, as the button on its page asks, and redirects to the page."""
    if caller.visible(services.record.jobs.line(job_id)) is None:
        raise no_such("job")
    services.record.jobs.request_cancel(job_id)
    return RedirectResponse(f"/jobs/{job_id}", 303, HEADERS)


@router.post("/jobs/{job_id}/continue")
def continue_job(job: KnownJob, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Continues a job that was cancelled or failed, as the button on its page asks, and redirects to the new job."""
    return RedirectResponse(f"/jobs/{continued(job, services, caller).id}", 303, HEADERS)


@router.get("/static/{path:path}")
def static(path: str) -> Response:
    """Style sheets, scripts and images. Their address begins with a version, so that browsers may cache them."""
    name = path.removeprefix(f"{VERSION}/")
    data = STATIC.get(name)
    if data is None:
        raise no_such("file")
    kept = "no-cache" if name == path else "max-age=31536000, immutable"
    kind = _KINDS.get(name.rpartition(".")[2], "text/plain")
    return Response(data, headers=HEADERS | {"Cache-Control": kept}, media_type=kind)


def _job(part: str, job_id: str, services: Services, caller: Caller, request: Request) -> Response:
    found = caller.visible(services.record.jobs.get(job_id, with_result=True))
    if found is None:
        raise no_such("job")
    if found.kind is JobKind.RERENDERING:
        return html(f"{part}rerendering.html", caller=caller, job=found)
    events = all_events(services.record, job_id)
    artifacts = services.record.jobs.artifacts(job_id)
    page = views.page(found, events, artifacts, _best_so_far(services, artifacts))
    said = about(found, services.record.lists.retries(job_id, caller.only), page.went_on)
    sent_again = commands(found.spec, str(request.base_url).rstrip("/"), with_key=bool(caller.key))
    return html(f"{part}job.html", caller=caller, page=page, about=said, commands=sent_again)


def _best_so_far(services: Services, artifacts: Sequence[Artifact]) -> dict[str, Any] | None:
    """What a job had found that ended before its time, if it has such a file."""
    for artifact in artifacts:
        if artifact.name == BEST_SO_FAR:
            with suppress(FileNotFoundError, Damaged), services.store.open(artifact.sha256) as file:
                found: dict[str, Any] = json.load(file)
                return found
    return None
