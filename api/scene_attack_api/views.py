"""Jobs and campaigns of the record as the API shows them."""

from dataclasses import asdict
from typing import Any

from scene_attack.client.schemas import CampaignJobView, CampaignSummary, CampaignView, JobSummary, JobView
from scene_attack.client.states import CampaignState, State, times_of
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.result import Outcome
from scene_attack_service.jobs.campaigns import Counts, Progress
from scene_attack_service.jobs.job_list import ListedJob
from scene_attack_service.jobs.models import Campaign, CampaignJob, Job

_OF_THE_RECORD = (
    *("id", "state", "attempt", "priority", "kind", "seed", "title", "retry_of", "checked", "warnings"),
    *("name", "scene", "attack", "renderer", "method", "target", "asked"),
)
"""The fields of a job that are as the record has them."""


def job_summary(job: ListedJob) -> JobSummary:
    """The summary of a job in a list."""
    return JobSummary(**_job_fields(job))


def job_view(job: Job, with_result: bool = False) -> JobView:
    """The view of a job; `with_result` requires that the job was read with its result."""
    return JobView(**_job_fields(job), spec=job.spec, note=job.note, result=job.result if with_result else None)


def campaign_summary(campaign: Campaign, progress: Progress) -> CampaignSummary:
    """The summary of a campaign."""
    return CampaignSummary(**_campaign_fields(campaign, progress))


def campaign_view(campaign: Campaign, progress: Progress, counts: Counts) -> CampaignView:
    """The view of a campaign that was read whole."""
    chosen = sum(bool(view["chosen"]) for view in campaign.views or [])
    return CampaignView(**_campaign_fields(campaign, progress), spec=campaign.spec, chosen=chosen, **asdict(counts))


def accepted_campaign(campaign: Campaign, spec: CampaignSpec) -> CampaignView:
    """The view of a campaign when it was accepted, whatever has become of it since."""
    begun = {"state": CampaignState.SELECTING, "selected": None, "paused": None, "ended": None, "failure": None}
    fields = _campaign_fields(campaign, Progress(0, 0, 0, 0)) | begun
    return CampaignView(**fields, spec=spec, chosen=0, outcomes={}, successes=0, reused=0, seconds_left=None)


def campaign_job_view(planned: CampaignJob, job: Job | None) -> CampaignJobView:
    """The view of a planned job and of its job in the record."""
    return CampaignJobView(
        number=planned.number,
        target=planned.target,
        attack=planned.attack,
        view=planned.view,
        job=planned.job_id,
        state=None if job is None else job.state,
        reused=planned.reused,
        outcome=None if job is None or job.outcome is None else Outcome.model_validate(job.outcome),
    )


def _job_fields(job: Job | ListedJob) -> dict[str, Any]:
    progress = failure = None
    if job.phase is not None:
        progress = {"phase": job.phase, "step": job.step, "steps": job.steps}
    if job.failure_kind is not None:
        failure = {"kind": job.failure_kind, "detail": job.failure_detail}
    return {name: getattr(job, name) for name in _OF_THE_RECORD} | {
        "created": job.created_at,
        "times": times_of(job),
        "waiting": job.waiting if job.state is State.QUEUED else None,
        "progress": progress,
        "tags": job.tags or [],
        "errors": job.errors or [],
        "outcome": job.outcome or None,
        "failure": failure,
    }


def _campaign_fields(campaign: Campaign, progress: Progress) -> dict[str, Any]:
    return {
        "id": campaign.id,
        "name": campaign.name,
        "state": campaign.state,
        "created": campaign.created_at,
        "selected": campaign.selected_at,
        "paused": campaign.paused_at,
        "ended": campaign.ended_at,
        "failure": campaign.failure,
        "progress": {
            "views": campaign.view_count,
            "answered": progress.views_answered,
            "jobs": progress.jobs,
            "ended": progress.ended,
            "running": progress.running,
        },
    }
