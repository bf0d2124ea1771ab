"""The form that adds a mesh or an environment map, on the page of assets."""

from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, Response, UploadFile
from fastapi.responses import RedirectResponse
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool

from api.access.authentication import CallerDependency, Client
from api.dashboard.assets import EVERYTHING, grid
from api.dashboard.pages import HEADERS
from api.routes.assets import form_body, store
from api.state import ServicesDependency
from services.errors import InvalidFields, InvalidRequest
from services.pipeline.field_errors import invalid_fields
from services.scenes.bundle import (
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

PATH = "/assets"
router = APIRouter(include_in_schema=False)
Text = Annotated[str, Form()]


class Said(BaseModel):
    """What the form says of the files; a field that is left empty says nothing."""

    name: Title | None
    up: Up | None
    licence: Licence | None
    credit: Credit | None


@router.post(PATH, dependencies=[Depends(form_body)])
async def add(
    services: ServicesDependency,
    caller: CallerDependency,
    client: Client,
    file: Annotated[list[UploadFile], File(default_factory=list)],
    mesh: Text = "",
    name: Text = "",
    up: Text = "",
    licence: Text = "",
    credit: Text = "",
) -> Response:
    """Stores the files as `POST /v1/assets` does and goes to the page of the asset. Errors are shown with the form."""
    said = {"mesh": mesh, "name": name, "up": up, "licence": licence, "credit": credit}
    sent = [one for one in file if one.filename]  # a browser sends an empty part for no file
    try:
        about = _about(said, sent)
        entry = await store(services, caller, client, sent, None, mesh or None, about)
    except InvalidRequest as error:
        return await run_in_threadpool(grid, services, caller, EVERYTHING, 1, errors=error.every, said=said)
    return RedirectResponse(f"{PATH}/{entry.name}", 303, HEADERS)


def _about(said: dict[str, str], sent: Sequence[UploadFile]) -> About:
    """What the form says; the name is by default the file's. Raises InvalidRequest."""
    if not sent:
        raise InvalidRequest("file", "choose the file of a mesh or of an environment map")
    if len(sent) > MAX_FILES:
        raise InvalidRequest("file", f"{len(sent):,} files were chosen; at most {MAX_FILES:,} are taken")
    if len(said["mesh"]) > MAX_NAME:
        raise InvalidRequest("mesh", f"it has {len(said['mesh']):,} characters; at most {MAX_NAME} are taken")
    try:
        fields = Said.model_validate({field: said[field].strip() or None for field in Said.model_fields})
    except ValidationError as error:
        raise InvalidFields(invalid_fields(error.errors(include_url=False), Said.model_json_schema())) from error
    return About(title=fields.name or _title(sent), up=fields.up, licence=fields.licence, credit=fields.credit)


def _title(sent: Sequence[UploadFile]) -> str | None:
    """The name of the first file that may be the mesh or the map, without its ending."""
    for path in (PurePosixPath(one.filename or "") for one in sent):
        if path.suffix.lower().removeprefix(".") in (*MESH_KINDS, *MAP_KINDS, "zip", "zae"):
            return title_of(path) or None
    return None
