"""The page "New job": a form beside a live preview. Without its script it is a form with the request as JSON.

The first request attacks the dents of a mesh, which is a change that a thing could have.
"""

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
from scene_attack.rendering.declaration import RENDERERS, Declaration
from scene_attack.runs.spec import JobSpec, parse
from scene_attack.runs.task_parts import TASKS
from scene_attack.strict import Names, NotJson, read_json
from scene_attack.targets.info import ANY_QUESTION, available
from scene_attack_api.dashboard.assets import picture
from scene_attack_api.dashboard.pages import HEADERS, html
from scene_attack_api.requests import CallerDependency, Services, ServicesDependency, names_of, no_such
from scene_attack_api.routes import jobs
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.processes import WARM_PROCESSES
from scene_attack_service.jobs.queue import Demand

FIRST = ("furniture/grand-piano", "furniture/soccer-ball", "primitive/sphere")
"""Meshes of the first scene: the first one that is installed."""
FIRST_ATTACK = {"renderer": "torch", "groups": ["bump"], "method": "fgsm"}
"""The attack of the first request."""

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
    """Data from which the form is made: the schema of a request, and what its fields may have, in words."""
    entries = [*services.library.entries(may_see=services.assets.visible(caller)), *services.library.environments()]
    maps = [[entry.name, entry.title] for entry in entries if entry.kind == "environment"]
    return {
        "schema": _schema(),
        "meshes": [
            {"name": entry.name, "title": entry.title, "kind": entry.category, "picture": picture(entry)}
            for entry in sorted(entries, key=lambda entry: (entry.kind != "upload", entry.category))
            if entry.kind != "environment"
        ],
        "environments": [*maps, ["lights", "the scene's own lights"]],
        "targets": [
            {
                "name": target.name,
                "words": target.title if target.missing is None else f"{target.title}; the first job fetches it",
                "question": target.example or ANY_QUESTION if _is_asked(target.task) else None,
                "gradient": target.differentiable is not False,
            }
            for target in available()
        ],
        "materials": [[name, ""] for name in _materials()],
        "gradient_methods": [name for name, attack in ATTACKS.items() if attack.needs_gradient],
        "renderers": {declared.name: _renderer(declared) for declared in _by_naturalness()},
    }


def _is_asked(task: str) -> bool:
    """Whether networks of a task are asked something about the image."""
    return task in TASKS and TASKS[task].ask is not None


def _by_naturalness() -> list[Declaration]:
    """The renderers, those with natural ranges first."""
    return sorted(RENDERERS.values(), key=lambda declared: -len(declared.natural_groups))


def _renderer(declared: Declaration) -> dict[str, Any]:
    """What the form says of a renderer and its groups, and which groups each method can attack."""
    return {
        "words": declared.explanation,
        "method": declared.method,
        "varies": list(declared.varies),
        "groups": [
            {
                "name": group.name,
                "words": group.words,
                "explanation": group.explanation,
                "natural_range": group.natural_range,
                "limit": group.suggested_limit,
                "by_default": group.by_default,
            }
            for group in declared.groups
        ],
        "fits": {
            method: [group for group in declared.group_names if _fits(declared.name, method, group)]
            for method in ATTACKS
        },
    }


@cache
def _fits(renderer: str, method: str, group: str) -> bool:
    """Whether a method can attack a group of a renderer; other settings that it needs are not given here."""
    attack = {"renderer": renderer, "method": method, "groups": [group]}
    try:
        parse({"scene": {"objects": [{"mesh": FIRST[-1]}]}, "attack": attack})
    except InvalidRequest as refused:
        return not any(error.field in ("attack.renderer", "attack.groups") for error in refused.every)
    return True


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
    return {"scene": {"objects": [{"mesh": mesh}]}, "attack": FIRST_ATTACK}


@cache
def _schema() -> dict[str, Any]:
    return JobSpec.model_json_schema()


@cache
def _materials() -> tuple[str, ...]:
    # The renderer's own module would import torch.
    text = files("scene_attack.rendering").joinpath("torch", "presets.json").read_text("utf-8")
    return tuple(json.loads(text)["presets"])
