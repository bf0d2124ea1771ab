"""Routes that give a finished job away: everything in one zip file, and its scene as glTF."""

from hashlib import sha256
from importlib.metadata import version
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Header, HTTPException, Request, Response
from fastapi.responses import FileResponse
from starlette.concurrency import run_in_threadpool

from api.authentication import Client
from api.conditional import matches
from api.routes.artifacts import VerifiedFile
from api.routes.connection import while_connected
from api.state import KnownJob, Services, ServicesDependency
from services.export import BUNDLE
from services.jobs.models import Job

router = APIRouter(prefix="/v1/jobs", tags=["artifacts"])

RESULT = "result.json"
IfNoneMatch = Annotated[str | None, Header()]


def _answers(media_type: str) -> dict[int | str, dict[str, Any]]:
    return {
        200: {"content": {media_type: {"schema": {"type": "string", "format": "binary"}}}},
        304: {"description": "the client has the file already"},
    }


@router.get("/{job_id}/export", response_class=FileResponse, responses=_answers("application/zip"))
async def download_export(
    request: Request,
    job: KnownJob,
    services: ServicesDependency,
    client: Client,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Downloads everything of a finished job in one zip file.

    It has the scenes before and after the attack as glTF, the images, the environment maps and normals of the torch
    renderer, the parameters with names and units, the request, the result and a README. 409 for a job without a result.
    """
    name = f"scene-attack-{job.id[:8]}.zip"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return await _made(request, job, services, client, BUNDLE, "application/zip", headers, if_none_match)


@router.get("/{job_id}/scene.glb", response_class=FileResponse, responses=_answers("model/gltf-binary"))
async def download_scene(
    request: Request,
    job: KnownJob,
    services: ServicesDependency,
    client: Client,
    which: Literal["before", "after"] = "after",
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Downloads the scene before or after the attack as a binary glTF file. 409 for a job without a result."""
    return await _made(request, job, services, client, which, "model/gltf-binary", {}, if_none_match)


async def _made(
    request: Request,
    job: Job,
    services: Services,
    client: str,
    what: str,
    media_type: str,
    headers: dict[str, str],
    if_none_match: str | None,
) -> Response:
    found = await run_in_threadpool(services.record.jobs.artifacts, job.id)
    artifacts = {one.name: one.sha256 for one in found}
    if RESULT not in artifacts:
        how = "has not ended" if not job.state.terminal else f"ended as {job.state.value}"
        raise HTTPException(409, f"the job has no result to export: it {how}")
    # The same artifacts and software give the same bytes.
    made_of = sha256(repr((version("scene-attack"), what, sorted(artifacts.items()))).encode()).hexdigest()[:32]
    headers |= {
        "ETag": f'"{made_of}"',
        "Cache-Control": "private, max-age=3600",
        "Content-Security-Policy": "default-src 'none'; sandbox",
    }
    if if_none_match is not None and matches(if_none_match, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    file = await while_connected(request, services.exporter.made(what, job.id, artifacts, client))
    return VerifiedFile(file, media_type, headers)
