"""The page "New job": a form beside a live preview. Without its script it is a form with the request as JSON."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Annotated, Any

from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.responses import RedirectResponse
from starlette.concurrency import run_in_threadpool

from scene_attack.attacks.attack import ATTACKS
from scene_attack.client.states import Priority
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.runs.spec import JobSpec, parse
from scene_attack.strict import Names, NotJson, read_json
from scene_attack.targets.info import available
from scene_attack_api.dashboard.pages import HEADERS, html
from scene_attack_api.requests import CallerDependency, Services, ServicesDependency, names_of, no_such
from scene_attack_api.routes import jobs
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.processes import WARM_PROCESSES
from scene_attack_service.jobs.queue import Demand

FIRST = ("furniture/grand-piano", "furniture/soccer-ball", "primitive/sphere")
"""Meshes of the first scene: the first one that is installed."""

router = APIRouter(include_in_schema=False)


@router.get("/new")
async def page(
    services: ServicesDependency,
    caller: CallerDependency,
    origin: Annotated[str | None, Query(alias="from", max_length=100, description="id of a job to clone")] = None,
    mesh: Annotated[str | None, Query(max_length=200, description="mesh of the first scene")] = None,
) -> Response:
    """The form, filled with a small request, that of another job (`from`), or one of a mesh (`mesh`)."""
    services.pool.start(WARM_PROCESSES)  # so that it is warm when the script asks
    return await run_in_threadpool(_form, services, caller, origin, mesh)


def _form(services: Services, caller: Caller, origin: str | None, mesh: str | None) -> Response:
    if origin is not None:
        job = caller.visible(services.record.jobs.get(origin))
        if job is None:
            raise no_such("job")
        return _page(caller, _written(job.spec), origin=origin)
    return _page(caller, _written(_first(services, caller, mesh)))


@router.post("/new")
async def submit(
    services: ServicesDependency, caller: CallerDependency, request: Request, spec: Annotated[str, Form()] = ""
) -> Response:
    """Queues the job whose JSON the form has, and goes to its page. Errors are shown with the form."""
    try:
        parsed = await run_in_threadpool(_parsed, spec, names_of(services, caller))
        priority = Demand(Priority.NORMAL)
        job = await jobs.submit_job(parsed, services, caller, request, Response(), priority)
    except InvalidRequest as error:
        return _page(caller, spec, error.every, 422)
    return RedirectResponse(f"/jobs/{job.id}", 303, HEADERS)


@router.get("/new/choices.json")
def choices(services: ServicesDependency, caller: CallerDependency) -> Any:
    """Data from which the form is made: the schema of a request, and the names that its fields may have."""
    entries = [*services.library.entries(may_see=services.assets.visible(caller)), *services.library.environments()]
    maps = [[entry.name, entry.title] for entry in entries if entry.kind == "environment"]
    return {
        "schema": _schema(),
        "meshes": [[entry.name, entry.title] for entry in entries if entry.kind != "environment"],
        "environments": [*maps, ["lights", "the scene's own lights"]],
        "targets": [[target.name, target.title] for target in available()],
        "materials": [[name, ""] for name in _materials()],
        "methods": list(ATTACKS),
        "renderers": {
            name: {
                "groups": [[group.name, group.words, group.by_default] for group in declared.groups],
                "method": declared.method,
            }
            for name, declared in RENDERERS.items()
        },
    }


def _parsed(text: str, names: Names) -> JobSpec:
    """The request that a text is. Raises InvalidRequest, with every wrong field."""
    try:
        return parse(read_json(text), names)
    except NotJson as error:
        raise InvalidRequest("body", str(error)) from error


def _page(
    caller: Caller, spec: str, errors: Sequence[InvalidRequest] = (), status: int = 200, origin: str | None = None
) -> Response:
    return html("new.html", status, caller, spec=spec, errors=errors, origin=origin)


def _written(spec: Mapping[str, Any]) -> str:
    return json.dumps(spec, indent=1, ensure_ascii=False)


def _first(services: Services, caller: Caller, mesh: str | None) -> dict[str, Any]:
    for name in FIRST if mesh is None else ():
        try:
            services.library.check_mesh(name, services.assets.visible(caller))
        except InvalidRequest:
            continue
        mesh = name
        break
    return {"scene": {"objects": [{"mesh": mesh}]}, "attack": {"renderer": "torch"}}


@cache
def _schema() -> dict[str, Any]:
    return JobSpec.model_json_schema()


@cache
def _materials() -> tuple[str, ...]:
    # The renderer's own module would import torch.
    text = files("scene_attack.rendering").joinpath("torch", "presets.json").read_text("utf-8")
    return tuple(json.loads(text)["presets"])
