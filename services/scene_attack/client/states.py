"""The states of jobs and campaigns, and the kinds and priorities of jobs."""

from datetime import datetime
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """The state of a job. Succeeded means that it ran to its end, not that the network was fooled. Rejected means that
    its request turned out to be one that cannot run: it was accepted before its check had ended.
    """

    QUEUED = "queued"
    RUNNING = "running"
    CANCELLING = "cancelling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    REJECTED = "rejected"
    CANCELLED = "cancelled"

    @property
    def terminal(self) -> bool:
        """Whether the job has ended, so that its state cannot change any more."""
        return self in (State.SUCCEEDED, State.FAILED, State.REJECTED, State.CANCELLED)


def times_of(job: Any) -> dict[str, datetime]:
    """The last time at which a job entered each state, in the order of the states."""
    return {state.value: time for state in State if (time := getattr(job, f"{state.value}_at")) is not None}


class CampaignState(StrEnum):
    """The state of a campaign. Finished means that all its jobs have ended, however they did."""

    SELECTING = "selecting"
    RUNNING = "running"
    PAUSED = "paused"
    FINISHED = "finished"
    CANCELLED = "cancelled"

    @property
    def terminal(self) -> bool:
        """Whether the campaign has ended, so that its state cannot change any more."""
        return self in (CampaignState.FINISHED, CampaignState.CANCELLED)


class JobKind(StrEnum):
    """The work that a job is. Lists show attacks, and re-renderings if they are asked to; selections are parts of
    campaigns.
    """

    ATTACK = "attack"
    RERENDERING = "rerendering"
    SELECTION = "selection"


class Priority(StrEnum):
    """The order in which jobs are taken: those of a higher priority first, and within one the owners in turn."""

    HIGH = "high"
    NORMAL = "normal"
    LOW = "low"
