"""The schemas of the API's responses about campaigns."""

from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any, Self

from pydantic import BaseModel, Field

from services.jobs.campaign_service import Counts
from services.jobs.campaigns import Progress
from services.jobs.models import Campaign, CampaignJob, CampaignState, Job, State
from services.pipeline.campaign_select import ChosenView
from services.pipeline.campaign_spec import CampaignSpec
from services.pipeline.outcome import Outcome


class CampaignProgress(BaseModel):
    """How far a campaign is: first in views, then in jobs."""

    views: int = Field(description="views that the networks are asked for")
    answered: int = Field(description="views whose first answer is known")
    jobs: int = Field(description="jobs on the chosen views; 0 until they are chosen")
    ended: int = Field(description="jobs that have ended")
    running: int = Field(description="jobs and parts of the selection that are running now")


class CampaignSummary(BaseModel):
    """A campaign, as lists show it."""

    id: str
    name: str
    state: CampaignState = Field(description="finished means that all its jobs have ended, however they did")
    created: datetime
    selected: datetime | None = Field(description="the time at which the views were chosen")
    paused: datetime | None
    ended: datetime | None
    failure: str | None = Field(description="why the campaign cannot go on")
    progress: CampaignProgress

    @classmethod
    def of(cls, campaign: Campaign, progress: Progress) -> Self:
        """The summary of a campaign in the database."""
        return cls(**_fields(campaign, progress))


class CampaignView(CampaignSummary):
    """A campaign with its request and its results so far."""

    spec: Annotated[CampaignSpec | dict[str, Any], Field(union_mode="left_to_right")] = Field(
        description="the request with the values of all fields filled in"
    )
    chosen: int = Field(description="views that are attacked; 0 until they are chosen")
    outcomes: dict[str, int] = Field(description="number of jobs of each outcome so far")
    successes: int = Field(description="jobs so far that fooled a network that was right, verified")
    reused: int = Field(description="jobs so far whose result was there already")
    seconds_left: float | None = Field(description="estimated from the jobs that have ended; null before that")

    @classmethod
    def of_whole(cls, campaign: Campaign, progress: Progress, counts: Counts) -> Self:
        """The view of a campaign that was read whole."""
        chosen = sum(bool(view["chosen"]) for view in campaign.views or [])
        return cls(**_fields(campaign, progress), spec=campaign.spec, chosen=chosen, **asdict(counts))

    @classmethod
    def accepted(cls, campaign: Campaign, spec: CampaignSpec) -> Self:
        """The view of a campaign when it was accepted, whatever has become of it since."""
        begun = {"state": CampaignState.SELECTING, "selected": None, "paused": None, "ended": None, "failure": None}
        fields = _fields(campaign, Progress(0, 0, 0, 0)) | begun
        return cls(**fields, spec=spec, chosen=0, outcomes={}, successes=0, reused=0, seconds_left=None)


class CampaignPage(BaseModel):
    """A page of the list of campaigns, newest first."""

    items: list[CampaignSummary]
    next: str | None = Field(description="`cursor` of the page after this one; null on the last")


class ViewList(BaseModel):
    """All views of a campaign, with the networks' first answers; empty until they are known."""

    items: list[ChosenView]


class CampaignJobView(BaseModel):
    """A job that a campaign has planned."""

    number: int
    target: str
    attack: str = Field(description="name of the attack in the campaign")
    view: int = Field(description="number of the view")
    job: str | None = Field(description="id of the job; null until it is queued")
    state: State | None = Field(description="state of the job; null until it is queued")
    reused: bool = Field(description="whether the job is an earlier one of the same request")
    outcome: Outcome | None = Field(description="the job's outcome, once it succeeded")

    @classmethod
    def of(cls, planned: CampaignJob, job: Job | None) -> Self:
        """The view of a planned job and of the job in the database."""
        return cls(
            number=planned.number,
            target=planned.target,
            attack=planned.attack,
            view=planned.view,
            job=planned.job_id,
            state=None if job is None else job.state,
            reused=planned.reused,
            outcome=None if job is None or job.outcome is None else Outcome.model_validate(job.outcome),
        )


class CampaignJobPage(BaseModel):
    """A page of a campaign's jobs, in the order in which they are queued."""

    items: list[CampaignJobView]
    next: int | None = Field(description="`after` of the page after this one; null on the last")


def _fields(campaign: Campaign, progress: Progress) -> dict[str, Any]:
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
