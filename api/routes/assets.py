"""Routes for meshes that users upload."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, HTTPException, Path, Request, UploadFile
from starlette.concurrency import run_in_threadpool

from api.authentication import CallerDependency
from api.routes.jobs import client_of
from api.schemas import AssetList
from api.state import ServicesDependency, no_such
from services.logs import logger
from services.scenes.library import Entry

PATH = "/v1/assets"
router = APIRouter(prefix=PATH, tags=["scenes"])
log = logger(__name__)


def form_body(request: Request) -> None:
    """Answers 415 unless the body is a multipart form."""
    if not request.headers.get("content-type", "").lower().startswith("multipart/form-data"):
        raise HTTPException(415, "send the mesh as multipart/form-data with the parts `file` and `kind`")


@router.post("", status_code=201, dependencies=[Depends(form_body)])
async def upload(
    services: ServicesDependency,
    caller: CallerDependency,
    request: Request,
    file: Annotated[UploadFile, File(description="the mesh; files that it refers to are not read")],
    kind: Annotated[str, Form(max_length=16, description="obj, ply, stl, glb or off")],
) -> Entry:
    """Checks a mesh and stores it under a hash of its bytes and kind. Scenes name it by the `name` in the answer."""
    await run_in_threadpool(services.quotas.check_upload, caller.owner, file.size or 0)
    adding = partial(services.assets.adding, caller.owner, size=file.size or 0)
    return await services.uploads.add(file.file, kind, client_of(request, caller), adding)


@router.get("")
def listing(services: ServicesDependency, caller: CallerDependency) -> AssetList:
    """Lists the uploaded meshes."""
    may_see = services.assets.visible(caller)
    return AssetList(items=services.library.entries(category="upload", may_see=may_see))


@router.delete("/{sha256}", status_code=204)
def delete(
    sha256: Annotated[str, Path(description="the 64 digits after `sha256:` in the mesh's name")],
    services: ServicesDependency,
    caller: CallerDependency,
) -> None:
    """Deletes an upload, with its files if no other owner has uploaded the same. Answers 409 while a job or campaign
    refers to the mesh. A key with `admin` deletes the uploads of all owners.
    """
    name = f"sha256:{sha256}"
    if caller.only is None and not services.library.has_upload(name):
        raise no_such("upload")
    if not services.assets.delete(caller, name):
        raise no_such("upload")
    try:
        services.deleted_assets.remove(name)
    except OSError as error:
        log.warning("files of a deleted upload are removed later", asset=name, error=str(error))
