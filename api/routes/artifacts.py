"""Routes for the files of a finished job."""

from collections.abc import Mapping
from io import BufferedIOBase
from typing import Annotated, Any

from fastapi import APIRouter, Header, HTTPException, Response
from fastapi.responses import FileResponse
from starlette.types import Receive, Scope, Send

from api.conditional import matches
from api.schemas import ArtifactList, ArtifactView
from api.state import KnownJob, ServicesDependency, no_such

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
    return ArtifactList(items=[ArtifactView.of(artifact) for artifact in services.record.jobs.artifacts(job.id)])


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
