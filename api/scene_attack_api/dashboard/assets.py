"""Routes of the pages about assets, the meshes and maps that a scene can name, and the form that adds one."""

import base64
from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, File, Form, Query, Request, Response, UploadFile
from fastapi.responses import FileResponse, RedirectResponse
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from scene_attack.client.schemas import Uploaded
from scene_attack.errors import InvalidRequest
from scene_attack.runs.spec import parsed
from scene_attack.runs.thumbnail import thumbnail_spec
from scene_attack.scenes.bundle import (
    MAP_KINDS,
    MAX_FILES,
    MAX_NAME,
    MESH_KINDS,
    About,
    Credit,
    Licence,
    Title,
    Up,
    title_of,
)
from scene_attack.scenes.library import Entry
from scene_attack_api.dashboard.pages import HEADERS, html
from scene_attack_api.requests import CallerDependency, Client, Services, ServicesDependency, no_such, while_connected
from scene_attack_api.routes.artifacts import VerifiedFile
from scene_attack_api.routes.assets import form_body, store
from scene_attack_service.access.caller import Caller, Scope

PAGE = 60
"""Number of assets on one page."""
JOBS = 24
"""Largest number of jobs whose images an asset's page shows."""

Kind = Literal["furniture", "primitive", "upload", "environment"]
Text = Annotated[str, Query(max_length=200)]
EVERYTHING: Mapping[str, str] = {"kind": "", "category": "", "licence": "", "q": ""}
NOTHING_SAID: Mapping[str, str] = {"mesh": "", "name": "", "up": "", "licence": "", "credit": ""}

router = APIRouter(include_in_schema=False)


@router.get("/assets")
def assets(
    services: ServicesDependency,
    caller: CallerDependency,
    kind: Kind | None = None,
    category: Text = "",
    licence: Text = "",
    q: Text = "",
    page: Annotated[int, Query(ge=1, le=10_000)] = 1,
) -> Response:
    """A grid of assets, narrowed by kind, category, licence and words."""
    return grid(services, caller, {"kind": kind or "", "category": category, "licence": licence, "q": q}, page)


def grid(
    services: Services,
    caller: Caller,
    chosen: Mapping[str, str],
    page: int,
    *,
    errors: Sequence[InvalidRequest] = (),
    said: Mapping[str, str] = NOTHING_SAID,
) -> Response:
    """The page of the assets that meet `chosen`, with the form that adds one: what was said in it and was wrong."""
    everything = _entries(services, caller)
    kind, category, licence = chosen["kind"], chosen["category"], chosen["licence"]
    words = chosen["q"].lower().split()
    matching = [
        entry
        for entry in everything
        if kind in ("", entry.kind)
        and category in ("", entry.category)
        and licence in ("", entry.licence)
        and all(word in f"{entry.name} {entry.title} {entry.creator}".lower() for word in words)
    ]
    begin = (page - 1) * PAGE
    entries = matching[begin : begin + PAGE]
    answers = services.record.uploads.first_answers([entry.name for entry in entries], caller.only)
    pages = {"newer": page - 1 if page > 1 else None, "older": page + 1 if begin + PAGE < len(matching) else None}
    return html(
        "assets.html",
        422 if errors else 200,
        caller,
        may_add=caller.may(Scope.ASSETS_WRITE),
        errors=errors,
        said=said,
        shown=[(entry, picture(entry), answers.get(entry.name, [])) for entry in entries],
        count=len(matching),
        begin=begin,
        chosen=chosen,
        kinds=list(dict.fromkeys(entry.kind for entry in everything)),
        categories=sorted({entry.category for entry in everything}),
        licences=sorted({entry.licence for entry in everything}),
        links={way: None if at is None else _address(chosen, at) for way, at in pages.items()},
    )


@router.get("/assets/pictures/{asset:path}")
async def asset_picture(
    request: Request, asset: str, services: ServicesDependency, caller: CallerDependency, client: Client
) -> Response:
    """The picture that a furniture library has of its model, or a primitive in the default light."""
    data = await run_in_threadpool(services.library.picture, asset)
    entry = await run_in_threadpool(services.library.entry, asset) if data is None else None
    if entry is not None and entry.kind == "primitive":
        asked = services.checks.preview(thumbnail_spec(asset), caller, client)
        data = base64.b64decode((await while_connected(request, asked))[1])
    if data is None:
        raise no_such("picture")
    headers = HEADERS | {"Cache-Control": "private, max-age=86400", "Content-Security-Policy": "default-src 'none'"}
    return Response(data, headers=headers, media_type="image/png")


@router.get("/assets/scenes/{asset:path}", response_class=FileResponse)
async def asset_scene(
    request: Request, asset: str, services: ServicesDependency, caller: CallerDependency, client: Client
) -> Response:
    """A mesh as a binary glTF file, for the view in three dimensions."""
    entry = await run_in_threadpool(_entry, services, caller, asset)
    if entry.kind == "environment":
        raise no_such("mesh")
    file = await while_connected(request, services.exporter.asset(entry.name, client))
    headers = {"Cache-Control": "private, max-age=3600", "Content-Security-Policy": "default-src 'none'; sandbox"}
    return VerifiedFile(file, "model/gltf-binary", headers)


@router.get("/assets/{asset:path}")
def one_asset(asset: str, services: ServicesDependency, caller: CallerDependency) -> Response:
    """The page of one asset."""
    entry = _entry(services, caller, asset)
    jobs = services.record.uploads.jobs(entry.name, JOBS, caller.only)
    answers = services.record.uploads.first_answers([entry.name], caller.only).get(entry.name, [])
    views = [(degrees(job.spec["scene"]["camera"]["azimuth"]), job) for job in jobs]
    about: dict[str, Any] = {"entry": entry, "picture": picture(entry), "answers": answers}
    return html("asset.html", caller=caller, **about, views=sorted(views, key=lambda view: view[0]))


def _entry(services: Services, caller: Caller, asset: str) -> Entry:
    """Raises HTTPException(404) for an asset that is not there, or that the caller may not see."""
    entry = next((entry for entry in _entries(services, caller) if entry.name == asset), None)
    if entry is None:
        raise no_such("asset")
    return entry


def _entries(services: Services, caller: Caller) -> list[Entry]:
    return [*services.library.entries(may_see=services.assets.visible(caller)), *services.library.environments()]


def picture(entry: Entry) -> str | None:
    """The address of an asset's picture; None if it has none."""
    if entry.kind in ("furniture", "primitive"):
        return f"/assets/pictures/{entry.name}"
    return Uploaded.of(entry).thumbnail if entry.name.startswith("sha256:") else None


def _address(chosen: Mapping[str, str], page: int) -> str:
    return "/assets?" + urlencode({name: value for name, value in chosen.items() if value} | {"page": page})


ASSETS_PATH = "/assets"
FormText = Annotated[str, Form()]


class Said(BaseModel):
    """Fields of the form about the files; None for a field that is left empty."""

    name: Title | None
    up: Up | None
    licence: Licence | None
    credit: Credit | None


@router.post(ASSETS_PATH, dependencies=[Depends(form_body)])
async def add(
    services: ServicesDependency,
    caller: CallerDependency,
    client: Client,
    file: Annotated[list[UploadFile], File(default_factory=list)],
    mesh: FormText = "",
    name: FormText = "",
    up: FormText = "",
    licence: FormText = "",
    credit: FormText = "",
) -> Response:
    """Stores the files as `POST /v1/assets` does and goes to the page of the asset. Errors are shown with the form."""
    form = {"mesh": mesh, "name": name, "up": up, "licence": licence, "credit": credit}
    sent = [upload for upload in file if upload.filename]  # a browser sends an empty part for no file
    try:
        about = _about(form, sent)
        entry = await store(services, caller, client, sent, None, mesh or None, about)
    except InvalidRequest as error:
        return await run_in_threadpool(grid, services, caller, EVERYTHING, 1, errors=error.every, said=form)
    return RedirectResponse(f"{ASSETS_PATH}/{entry.name}", 303, HEADERS)


def _about(form: dict[str, str], sent: Sequence[UploadFile]) -> About:
    """Reads the form; the name is by default the file's. Raises InvalidRequest."""
    if not sent:
        raise InvalidRequest("file", "choose the file of a mesh or of an environment map")
    if len(sent) > MAX_FILES:
        raise InvalidRequest("file", f"{len(sent):,} files were chosen; at most {MAX_FILES:,} are taken")
    if len(form["mesh"]) > MAX_NAME:
        raise InvalidRequest("mesh", f"it has {len(form['mesh']):,} characters; at most {MAX_NAME} are taken")
    fields = parsed(Said, {field: form[field].strip() or None for field in Said.model_fields})
    return About(title=fields.name or _title(sent), up=fields.up, licence=fields.licence, credit=fields.credit)


def _title(sent: Sequence[UploadFile]) -> str | None:
    """The name of the first file that may be the mesh or the map, without its ending."""
    for path in (PurePosixPath(upload.filename or "") for upload in sent):
        if path.suffix.lower().removeprefix(".") in (*MESH_KINDS, *MAP_KINDS, "zip", "zae"):
            return title_of(path) or None
    return None
