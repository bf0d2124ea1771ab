"""Routes of campaigns, from their submission to their tables."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from scene_attack.analysis.campaign_table import cases_to_csv, to_csv, to_latex
from scene_attack.client.schemas import CampaignJobPage, CampaignPage, CampaignView, ViewList
from scene_attack.client.states import Priority
from scene_attack.runs.campaign_plan import CampaignResult
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.spec import digest
from scene_attack_api.cursors import campaign_cursor, read_campaign_cursor
from scene_attack_api.requests import (
    CallerDependency,
    IdempotencyKey,
    Services,
    ServicesDependency,
    body_of,
    demand,
    json_body,
    no_such,
    while_connected,
)
from scene_attack_api.views import accepted_campaign, campaign_job_view, campaign_summary, campaign_view
from scene_attack_service.jobs.jobs import Key
from scene_attack_service.jobs.models import Campaign, CampaignState
from scene_attack_service.jobs.queue import Demand

router = APIRouter(prefix="/v1/campaigns", tags=["campaigns"])


def whole_campaign(campaign_id: str, services: ServicesDependency, caller: CallerDependency) -> Campaign:
    """The campaign with the id in the path, with its request and views. Answers 404 if there is none for the caller."""
    campaign = caller.visible(services.record.campaigns.get(campaign_id, whole=True))
    if campaign is None:
        raise no_such("campaign")
    return campaign


WholeCampaign = Annotated[Campaign, Depends(whole_campaign)]


@router.post("", status_code=202, response_model=CampaignView, dependencies=[Depends(json_body)])
async def submit_campaign(
    spec: Annotated[CampaignSpec, Depends(body_of(CampaignSpec))],
    services: ServicesDependency,
    caller: CallerDependency,
    request: Request,
    asked: Annotated[Demand, Depends(demand(Priority.LOW))],
    idempotency_key: IdempotencyKey = None,
) -> Any:
    """Starts a campaign.

    The request, its size and the names in it are checked before the answer, and one job for each target, renderer and
    method as a whole, as far as that takes a few seconds. What is wrong with a single view shows when the views are
    selected: it is then not attacked.
    """
    key = None
    if idempotency_key is not None:
        key = Key(idempotency_key, await run_in_threadpool(digest, spec), caller.owner)
    campaign = None if key is None else await run_in_threadpool(services.record.campaigns.of_key, key)
    if campaign is None:
        await while_connected(request, services.checks.check_campaign(spec, caller))
        whose, most = caller.owner, services.quotas.campaigns_of(caller.owner)
        campaign = await run_in_threadpool(services.record.campaigns.submit, spec, idempotency_key, whose, asked, most)
    # The answer to a long list of jobs is large, so it is written in a thread too.
    answer = await run_in_threadpool(lambda: accepted_campaign(campaign, spec).model_dump_json())
    headers = {"Location": f"/v1/campaigns/{campaign.id}"}
    return Response(answer, 202, headers, "application/json")


@router.get("")
def list_campaigns(
    services: ServicesDependency,
    caller: CallerDependency,
    state: CampaignState | None = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(max_length=200, description="`next` of the page before")] = None,
) -> CampaignPage:
    """Lists campaigns, newest first."""
    record = services.record.campaigns
    rows = record.page(state, limit + 1, None if cursor is None else read_campaign_cursor(cursor), caller.only)
    progress = record.progress([campaign.id for campaign in rows])
    return CampaignPage(
        items=[campaign_summary(campaign, progress[campaign.id]) for campaign in rows[:limit]],
        next=campaign_cursor(rows[limit - 1]) if len(rows) > limit else None,
    )


@router.get("/{campaign_id}")
def get_campaign(campaign: WholeCampaign, services: ServicesDependency) -> CampaignView:
    """Returns one campaign, with its progress, its outcomes so far and the time left."""
    return _view(campaign, services)


@router.post("/{campaign_id}/pause", status_code=202)
def pause_campaign(campaign: WholeCampaign, services: ServicesDependency) -> CampaignView:
    """Holds a campaign's queued jobs back, also over restarts; jobs that run go on to their end.

    A campaign that is paused or has ended stays as it is.
    """
    services.record.campaigns.pause(campaign.id)
    return _view(_again(campaign, services), services)


@router.post("/{campaign_id}/resume", status_code=202)
def resume_campaign(campaign: WholeCampaign, services: ServicesDependency) -> CampaignView:
    """Lets a paused campaign go on. A campaign that is not paused stays as it is."""
    services.record.campaigns.resume(campaign.id)
    return _view(_again(campaign, services), services)


@router.post("/{campaign_id}/cancel", status_code=202)
def cancel_campaign(campaign: WholeCampaign, services: ServicesDependency) -> CampaignView:
    """Ends a campaign: queued jobs are cancelled at once, running ones stop within a step. Results so far stay.

    A campaign that has ended stays as it is.
    """
    services.storage.even_if_full(lambda: services.record.campaigns.cancel(campaign.id))
    return _view(_again(campaign, services), services)


@router.get("/{campaign_id}/views")
def list_campaign_views(campaign: WholeCampaign) -> ViewList:
    """Lists all views with the networks' first answers, and says of those that are not attacked why."""
    return ViewList.model_validate({"items": campaign.views or []})


@router.get("/{campaign_id}/jobs")
def list_campaign_jobs(
    campaign: WholeCampaign,
    services: ServicesDependency,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
    after: Annotated[int, Query(ge=-1, le=2**31 - 1, description="number of a job; the page begins after it")] = -1,
) -> CampaignJobPage:
    """Lists the planned jobs in the order in which they are queued."""
    rows = services.record.campaigns.jobs(campaign.id, limit + 1, after)
    items = [campaign_job_view(planned, job) for planned, job in rows[:limit]]
    return CampaignJobPage(items=items, next=items[-1].number if len(rows) > limit else None)


@router.get("/{campaign_id}/table.json")
def get_campaign_table(campaign: WholeCampaign, services: ServicesDependency) -> CampaignResult:
    """Returns the table of the jobs that have ended, the mean curves of their traces, and all views."""
    return services.record.campaigns.result(campaign)


@router.get(
    "/{campaign_id}/table.csv",
    response_class=Response,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
def get_campaign_table_csv(campaign: WholeCampaign, services: ServicesDependency) -> Response:
    """Returns the table as CSV, one line for each target and attack."""
    return Response(to_csv(services.record.campaigns.result(campaign, curves=False).table), media_type="text/csv")


@router.get(
    "/{campaign_id}/table.tex",
    response_class=Response,
    responses={200: {"content": {"text/x-tex": {"schema": {"type": "string"}}}}},
)
def get_campaign_table_latex(campaign: WholeCampaign, services: ServicesDependency) -> Response:
    """Returns the table as LaTeX, in the paper's layout, for the package booktabs."""
    return Response(to_latex(services.record.campaigns.result(campaign, curves=False).table), media_type="text/x-tex")


@router.get(
    "/{campaign_id}/cases.csv",
    response_class=Response,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
def get_campaign_cases_csv(campaign: WholeCampaign, services: ServicesDependency) -> Response:
    """Returns the jobs that have ended as CSV, one line for each, with scene, seed, outcome, p, queries and seconds."""
    return Response(cases_to_csv(services.record.campaigns.case_rows(campaign)), media_type="text/csv")


def _again(campaign: Campaign, services: Services) -> Campaign:
    stored = services.record.campaigns.get(campaign.id, whole=True)
    if stored is None:
        raise no_such("campaign")
    return stored


def _view(campaign: Campaign, services: Services) -> CampaignView:
    return campaign_view(
        campaign, services.record.campaigns.progress([campaign.id])[campaign.id], services.campaign_counts(campaign.id)
    )
