"""Routes for the files of a job, and those that give a finished one away: all of it in one zip file, and its scene as
glTF.
"""

from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import version
from io import BufferedIOBase
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Header, HTTPException, Request, Response
from fastapi.responses import FileResponse
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from scene_attack.client.schemas import ArtifactList
from scene_attack.export import BUNDLE
from scene_attack_api.requests import Client, KnownJob, Services, ServicesDependency, matches, no_such, while_connected
from scene_attack_service.jobs.models import Job

router = APIRouter(prefix="/v1/jobs", tags=["artifacts"])

_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {
            "application/octet-stream": {"schema": {"type": "string", "format": "binary"}},
            "application/json": {},
            "image/png": {},
        }
    },
    206: {"description": "the requested range"},
    304: {"description": "the client has the file already"},
}


class VerifiedFile(FileResponse):
    """An open file, sent as a whole or in ranges, and closed afterwards. It need not have a name."""

    def __init__(self, file: BufferedIOBase, media_type: str, headers: Mapping[str, str]) -> None:
        super().__init__(f"/proc/self/fd/{file.fileno()}", media_type=media_type, headers=headers)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        with self._file:
            await super().__call__(scope, receive, send)


@router.get("/{job_id}/artifacts")
def list_artifacts(job: KnownJob, services: ServicesDependency) -> ArtifactList:
    """Lists the files of a job; of one that has not ended the list is empty but for a checkpoint to go on from."""
    return ArtifactList.model_validate({"items": services.record.jobs.artifacts(job.id)}, from_attributes=True)


@router.head(
    "/{job_id}/artifacts/{name}", operation_id="get_artifact_headers", response_class=FileResponse, responses=_ANSWERS
)
@router.get("/{job_id}/artifacts/{name}", response_class=FileResponse, responses=_ANSWERS)
def download_artifact(
    job: KnownJob, name: str, services: ServicesDependency, if_none_match: Annotated[str | None, Header()] = None
) -> Response:
    """Downloads a file; HEAD answers the same without the file.

    Its ETag is the hash of its bytes, it never changes, and Range requests return parts of it.
    """
    artifact = services.record.jobs.artifact(job.id, name)
    if artifact is None:
        raise no_such("artifact")
    headers = {
        "ETag": f'"{artifact.sha256}"',
        "Cache-Control": "private, max-age=31536000, immutable",
        # A browser must not run a file as a page of this site.
        "Content-Security-Policy": "default-src 'none'; sandbox",
    }
    if if_none_match is not None and matches(if_none_match, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    try:
        file = services.store.open(artifact.sha256)
    except FileNotFoundError as error:
        raise HTTPException(410, "its bytes are gone from the artifact store") from error
    return VerifiedFile(file, artifact.media_type, headers)


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
    rows = await run_in_threadpool(services.record.jobs.artifacts, job.id)
    artifacts = {artifact.name: artifact.sha256 for artifact in rows}
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
