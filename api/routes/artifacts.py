"""The files of a finished job."""

import re
from typing import Annotated

from fastapi import APIRouter, Header, HTTPException, Response
from fastapi.responses import FileResponse

from api.schemas import ArtifactList, ArtifactView
from api.state import KnownJob, ServicesDependency, no_such

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


@router.get("/{job_id}/artifacts")
def listing(job: KnownJob, services: ServicesDependency) -> ArtifactList:
    """The files of a job; none until it succeeded."""
    return ArtifactList(items=[ArtifactView.of(artifact) for artifact in services.repository.artifacts(job.id)])


@router.get(
    "/{job_id}/artifacts/{name}",
    response_class=FileResponse,
    responses={
        200: {"content": {"application/octet-stream": {}, "application/json": {}, "image/png": {}}},
        206: {"description": "the range asked for"},
        304: {"description": "the client has it already"},
    },
)
def download(
    job: KnownJob, name: str, services: ServicesDependency, if_none_match: Annotated[str | None, Header()] = None
) -> Response:
    """One file. Its ETag is the hash of its bytes; it never changes, and parts of it can be had by Range."""
    artifact = services.repository.artifact(job.id, name)
    if artifact is None:
        raise no_such("artifact")
    headers = {
        "ETag": f'"{artifact.sha256}"',
        "Cache-Control": "private, max-age=31536000, immutable",
        # A file is never a page of this site, whatever is in it.
        "Content-Security-Policy": "default-src 'none'; sandbox",
    }
    if if_none_match is not None and _matches(if_none_match, artifact.sha256):
        return Response(status_code=304, headers=headers)
    path = services.store.path(artifact.sha256)
    if not path.exists():
        raise HTTPException(410, "its bytes are gone from the data directory")
    return FileResponse(path, media_type=artifact.media_type, headers=headers)


def _matches(if_none_match: str, sha256: str) -> bool:
    return if_none_match.strip() == "*" or sha256 in re.findall(r'"([^"]*)"', if_none_match)
