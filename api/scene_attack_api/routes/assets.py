"""Routes for meshes and environment maps that users upload, and those that list the names a request can use."""

import base64
from collections.abc import Sequence
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, HTTPException, Path, Query, Request, Response, UploadFile
from pydantic import BeforeValidator
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile as StarletteUploadFile

from scene_attack.client.schemas import AssetList, SceneLibrary, TargetList, Uploaded
from scene_attack.logs import logger
from scene_attack.runs.thumbnail import picture_of, thumbnail_spec
from scene_attack.scenes.bundle import MAX_FILES, MAX_NAME, About, Credit, Licence, Title, Up
from scene_attack.scenes.library import Entry
from scene_attack.targets.info import available
from scene_attack_api.requests import CallerDependency, Client, Services, ServicesDependency, no_such, while_connected
from scene_attack_api.uploads import Sent
from scene_attack_service.access.caller import Caller

PATH = "/v1/assets"
Digest = Annotated[str, Path(description="the 64 digits after `sha256:` in the upload's name")]
router = APIRouter(prefix="/v1")
log = logger(__name__)


def _file(part: object) -> object:
    if not isinstance(part, StarletteUploadFile):
        raise ValueError('must be a file, which is a part with a `filename="…"`; this part is a text')
    return part


def form_body(request: Request) -> None:
    """Answers 415 unless the body is a multipart form."""
    if not request.headers.get("content-type", "").lower().startswith("multipart/form-data"):
        raise HTTPException(415, "send the mesh as multipart/form-data, as the part `file`")


@router.post("/assets", tags=["assets"], status_code=201, dependencies=[Depends(form_body)])
async def upload_asset(
    services: ServicesDependency,
    caller: CallerDependency,
    client: Client,
    file: Annotated[
        list[Annotated[UploadFile, BeforeValidator(_file)]],
        File(
            min_length=1,
            max_length=MAX_FILES,
            description="the mesh, and the material libraries and textures that it names, each a part with its path "
            "as file name; or one zip file of them",
        ),
    ],
    kind: Annotated[
        str | None,
        Form(
            max_length=16,
            description="obj, ply, stl, glb, off, gltf, dae or 3mf, or of an environment map hdr or exr; by default "
            "the ending of its name",
        ),
    ] = None,
    mesh: Annotated[
        str | None, Form(max_length=MAX_NAME, description="which file is the mesh, if there are several meshes")
    ] = None,
    name: Annotated[Title | None, Form()] = None,
    up: Annotated[
        Up | None, Form(description="the axis of the file that points up; by default its format says it")
    ] = None,
    licence: Annotated[Licence | None, Form()] = None,
    credit: Annotated[Credit | None, Form()] = None,
) -> Uploaded:
    """Checks a mesh or an environment map and stores it, with the files that a mesh names, under a hash of all of it.
    Scenes name it by the `name` in the answer, which also says what of the files is `used`, and in `notes` what is not.
    """
    about = About(title=name, up=up, licence=licence, credit=credit)
    return Uploaded.of(await store(services, caller, client, file, kind, mesh, about))


async def store(
    services: Services,
    caller: Caller,
    client: str,
    files: Sequence[UploadFile],
    kind: str | None,
    mesh: str | None,
    about: About,
) -> Entry:
    """Checks and stores the files of a form for its caller. Raises InvalidRequest, QuotaExceeded and Unavailable."""
    await run_in_threadpool(services.quotas.check_upload, caller.owner, sum(upload.size or 0 for upload in files))
    sent = Sent([(upload.filename or "", upload.file) for upload in files], kind, mesh, about)
    adding = partial(services.assets.adding, caller.owner)
    return await services.uploads.add(sent, client, adding)


@router.get("/assets", tags=["assets"])
def list_assets(services: ServicesDependency, caller: CallerDependency) -> AssetList:
    """Lists the uploaded meshes and environment maps."""
    may_see = services.assets.visible(caller)
    entries = services.library.entries(category="upload", may_see=may_see)
    return AssetList(items=[Uploaded.of(entry) for entry in entries])


def known_upload(sha256: Digest, services: ServicesDependency, caller: CallerDependency) -> str:
    """The name of the upload with the digest in the path. Answers 404 if there is none for the caller."""
    name = f"sha256:{sha256}"
    if not (services.assets.visible(caller)(name) and services.library.has_upload(name)):
        raise no_such("upload")
    return name


KnownUpload = Annotated[str, Depends(known_upload)]


@router.get("/assets/{sha256}", tags=["assets"])
def get_asset(name: KnownUpload, services: ServicesDependency) -> Uploaded:
    """Returns an upload's name, licence and credit, and what is shown of its files."""
    entry = services.library.entry(name)
    if entry is None:  # it was deleted meanwhile
        raise no_such("upload")
    return Uploaded.of(entry)


@router.get(
    "/assets/{sha256}/thumbnail",
    tags=["assets"],
    response_class=Response,
    responses={200: {"content": {"image/png": {}}}},
)
async def download_thumbnail(
    name: KnownUpload, services: ServicesDependency, caller: CallerDependency, client: Client, request: Request
) -> Response:
    """Returns a picture of an upload, a PNG image that never changes: a mesh in the default light, or a map as it is.

    It is made when it is first asked for; 503 says that other previews took all the time.
    """
    kept = await run_in_threadpool(services.library.thumbnail, name)
    if kept is None:
        entry = await run_in_threadpool(services.library.entry, name)
        if entry is not None and entry.kind == "environment":
            kept = await run_in_threadpool(lambda: picture_of(services.library.environment(name)))
        else:
            asked = services.checks.preview(thumbnail_spec(name), caller, client)
            _, shown = await while_connected(request, asked)
            kept = base64.b64decode(shown)
        await run_in_threadpool(services.library.keep_thumbnail, name, kept)
    headers = {"Cache-Control": "private, max-age=31536000, immutable", "Content-Security-Policy": "default-src 'none'"}
    return Response(kept, media_type="image/png", headers=headers)


@router.delete("/assets/{sha256}", tags=["assets"], status_code=204)
def delete_asset(
    sha256: Digest,
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


Filter = Annotated[str | None, Query(max_length=200)]


@router.get("/scenes", tags=["assets"], response_model=SceneLibrary)
def get_scene_library(
    services: ServicesDependency,
    caller: CallerDependency,
    category: Filter = None,
    creator: Filter = None,
    licence: Filter = None,
    search: Filter = None,
) -> Response:
    """Lists the meshes that match all given filters, the environment maps, of uploads those that match, and their
    credits.
    """
    entries = services.library.entries(category, creator, licence, search, services.assets.visible(caller))
    meshes = [entry for entry in entries if entry.kind != "environment"]
    uploaded_maps = [entry for entry in entries if entry.kind == "environment"]
    environments = [*services.library.environments(), *uploaded_maps]
    credits_ = {entry.credit for entry in [*meshes, *environments] if entry.credit is not None}
    listed = SceneLibrary(meshes=meshes, environments=environments, credits=sorted(credits_))
    return Response(listed.model_dump_json(), media_type="application/json")  # the framework would validate it again


@router.get("/targets", tags=["targets"])
def list_targets() -> TargetList:
    """Lists the networks that can be attacked."""
    return TargetList(items=available())
