"""The route of the re-rendering defence."""

import binascii
from typing import Annotated

from fastapi import APIRouter, Depends, Request
from starlette.concurrency import run_in_threadpool

from api.authentication import CallerDependency
from api.bodies import body_of
from api.rerenderer import decoded
from api.routes.connection import while_connected
from api.routes.jobs import json_body
from api.schemas import RerenderingBody, RerenderingView
from api.state import Services, ServicesDependency, names_of, no_such
from services.access.caller import Caller
from services.errors import InvalidRequest
from services.pipeline.names_known import check_names
from services.pipeline.spec import JobSpec

router = APIRouter(prefix="/v1/rerenderings", tags=["defences"])


@router.post("", dependencies=[Depends(json_body)])
async def rerender_image(
    request: Request,
    body: Annotated[RerenderingBody, Depends(body_of(RerenderingBody))],
    services: ServicesDependency,
    caller: CallerDependency,
) -> RerenderingView:
    """Fits the scene's normals, illumination and material to an image, and classifies the fitted scene's rendering.

    The answer comes when the fit has ended: one image at a time, for at most five minutes. A client that closes its
    connection ends it.
    """
    image, spec = await run_in_threadpool(_read, body, services, caller)
    work = services.rerenderer.rerender(image, spec, body.fit)
    return RerenderingView.model_validate(await while_connected(request, work))


def _read(body: RerenderingBody, services: Services, caller: Caller) -> tuple[bytes, JobSpec]:
    """The image's bytes, and a spec with the scene and the target."""
    given: dict[str, object] = {}
    if body.image.job is not None:
        job = caller.visible(services.repository.get(body.image.job))
        artifact = None if job is None else services.repository.artifact(job.id, body.image.artifact)
        if job is None or artifact is None:
            raise InvalidRequest("image.job", "there is no such job, or it has no file of this name")
        try:
            with services.store.open(artifact.sha256) as file:
                image = file.read()
        except FileNotFoundError as error:
            raise no_such("file of the job any more") from error
        given = {"scene": job.spec["scene"], "target": job.spec["target"]}
    else:
        try:
            image = decoded(body.image.data or "")
        except (binascii.Error, ValueError) as error:
            raise InvalidRequest("image.data", "it is not base64") from error
    if body.scene is not None:
        given["scene"] = body.scene.model_dump(mode="json")
    if body.target is not None:
        given["target"] = body.target.model_dump(mode="json")
    if "scene" not in given:
        raise InvalidRequest("scene", "an image that is no file of a job needs its scene")
    spec = JobSpec.model_validate(given)
    if body.scene is not None:
        check_names(spec, names_of(services, caller))
    return image, spec
