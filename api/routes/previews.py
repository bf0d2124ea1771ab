"""The route that previews a request."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request

from api.authentication import CallerDependency, Client
from api.bodies import body_of
from api.routes.connection import while_connected
from api.routes.jobs import json_body
from api.schemas import PreviewView
from api.state import ServicesDependency
from services.pipeline.preview_record import PlannedCost
from services.pipeline.spec import JobSpec

router = APIRouter(prefix="/v1/preview", tags=["jobs"])


@router.post("", dependencies=[Depends(json_body)])
async def preview_job(
    spec: Annotated[JobSpec, Depends(body_of(JobSpec))],
    services: ServicesDependency,
    caller: CallerDependency,
    client: Client,
    request: Request,
    plan: Annotated[
        bool, Query(description="whether to make the plan, too, which may take several times as long as the image")
    ] = False,
) -> PreviewView:
    """Shows what a job would begin with: the image, the network's first five answers, the warnings, and on demand the
    plan and its cost.

    Nothing is attacked and nothing is queued. A request that cannot run gets the same answer 422 as a job. One that
    takes longer than a preview may gets 413, and 503 says that other previews took all the time. A client that closes
    its connection gives up its turn.
    """
    shown, png = await while_connected(request, services.checks.preview(spec, caller, client))
    planned: PlannedCost | None = None
    if plan:
        planned = await while_connected(request, services.checks.plan(spec, client))
    return PreviewView(
        **dict(shown),
        png=png,
        plan=None if planned is None else planned.plan,
        cost=None if planned is None else planned.cost,
    )
