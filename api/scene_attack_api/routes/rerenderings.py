"""The route of the re-rendering defence."""

import base64
from hashlib import sha256
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from scene_attack.client.schemas import JobView, RerenderingBody
from scene_attack.errors import InvalidRequest
from scene_attack.runs.spec import SENT_IMAGE, RerenderingSpec, check_names
from scene_attack_api.requests import (
    SUBMISSION,
    CallerDependency,
    Client,
    DemandOfQuery,
    IdempotencyKey,
    PreferredWait,
    Services,
    ServicesDependency,
    body_of,
    names_of,
    no_such,
    while_connected,
)
from scene_attack_api.routes.jobs import answered
from scene_attack_api.submissions import Checked, key_of
from scene_attack_service.access.caller import Caller
from scene_attack_service.jobs.models import Artifact

router = APIRouter(prefix="/v1/rerenderings", tags=["defences"])


@router.post("", **SUBMISSION)
async def rerender_image(
    body: Annotated[RerenderingBody, Depends(body_of(RerenderingBody))],
    services: ServicesDependency,
    caller: CallerDependency,
    client: Client,
    request: Request,
    response: Response,
    demand: DemandOfQuery,
    wait: PreferredWait = None,
    idempotency_key: IdempotencyKey = None,
) -> JobView:
    """Queues a job that fits the scene's normals, illumination and material to an image, and classifies the fitted
    scene's rendering.

    Lists of jobs show it if they are asked for the kind `rerendering`. The image and the request are checked before the
    answer, as those of `POST /v1/jobs` are, and `Prefer: wait=N` has the same meaning.
    """
    image, spec = await run_in_threadpool(_read, body, services, caller)
    key = key_of(idempotency_key, spec, caller)
    job = await services.submissions.earlier(key)
    if job is None:
        checked = await while_connected(request, _check(image, spec, services, caller, client))
        file = await run_in_threadpool(_stored, image, services)
        job = await services.submissions.submit(spec, checked, caller, demand, key, file)
    return await answered(job, wait, services, response)


async def _check(
    image: bytes, spec: RerenderingSpec, services: Services, caller: Caller, client: str
) -> Checked | None:
    await services.uploads.check_image(image, spec.scene.camera.size, client)
    return await services.checks.check(spec.attack(), caller)


def _read(body: RerenderingBody, services: Services, caller: Caller) -> tuple[bytes, RerenderingSpec]:
    """The image's bytes, and the job's request."""
    fields: dict[str, object] = {"target": {}}
    if body.image.job is not None:
        job = caller.visible(services.record.jobs.get(body.image.job))
        artifact = None if job is None else services.record.jobs.artifact(job.id, body.image.artifact)
        if job is None or artifact is None:
            raise InvalidRequest("image.job", "there is no such job, or it has no file of this name")
        try:
            with services.store.open(artifact.sha256) as file:
                image = file.read()
        except FileNotFoundError as error:
            raise no_such("file of the job any more") from error
        fields = {"scene": job.spec["scene"], "target": job.spec["target"]}
    else:
        try:
            image = base64.b64decode(body.image.data or "", validate=True)
        except ValueError as error:
            raise InvalidRequest("image.data", "it is not base64") from error
    if body.scene is not None:
        fields["scene"] = body.scene.model_dump(mode="json")
    if body.target is not None:
        fields["target"] = body.target.model_dump(mode="json")
    if "scene" not in fields:
        raise InvalidRequest("scene", "an image that is no file of a job needs its scene")
    about = {"image": sha256(image).hexdigest(), "fit": body.fit.model_dump(mode="json")}
    spec = RerenderingSpec.model_validate(fields | about)
    if body.scene is not None:
        check_names(spec.attack(), names_of(services, caller))
    return image, spec


def _stored(image: bytes, services: Services) -> Artifact:
    with NamedTemporaryFile() as file:
        file.write(image)
        file.flush()
        artifact = services.store.put(Path(file.name))
    artifact.name = SENT_IMAGE
    return artifact
