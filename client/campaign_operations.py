"""The operations of the HTTP API on campaigns, as `client.operations` has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from client.request import CHECK_SECONDS, Device, Request

if TYPE_CHECKING:
    from client.answers import (
        CampaignJobPage,
        CampaignPage,
        CampaignResult,
        CampaignSpec,
        CampaignState,
        CampaignView,
        Priority,
        ViewList,
    )


def submit_campaign(
    spec: CampaignSpec | Mapping[str, Any],
    *,
    priority: Priority | None = None,
    device: Device | None = None,
    memory: int | None = None,
    idempotency_key: str | None = None,
) -> Request[CampaignView]:
    """Starts a campaign; priority, device and memory are those of its jobs."""
    return Request(
        "POST",
        "/v1/campaigns",
        params={"priority": priority, "device": device, "memory": memory},
        headers={"Idempotency-Key": idempotency_key},
        json=spec,
        seconds=CHECK_SECONDS,
    )


def list_campaigns(
    *, state: CampaignState | None = None, limit: int | None = None, cursor: str | None = None
) -> Request[CampaignPage]:
    """A page of the campaigns, newest first."""
    return Request("GET", "/v1/campaigns", params={"state": state, "limit": limit, "cursor": cursor})


def get_campaign(campaign_id: str) -> Request[CampaignView]:
    """One campaign, with its request, progress and outcomes."""
    return Request("GET", "/v1/campaigns/{campaign_id}", {"campaign_id": campaign_id})


def pause_campaign(campaign_id: str) -> Request[CampaignView]:
    """Holds a campaign's queued jobs back."""
    return Request("POST", "/v1/campaigns/{campaign_id}/pause", {"campaign_id": campaign_id})


def resume_campaign(campaign_id: str) -> Request[CampaignView]:
    """Lets a paused campaign go on."""
    return Request("POST", "/v1/campaigns/{campaign_id}/resume", {"campaign_id": campaign_id})


def cancel_campaign(campaign_id: str) -> Request[CampaignView]:
    """Ends a campaign and its jobs."""
    return Request("POST", "/v1/campaigns/{campaign_id}/cancel", {"campaign_id": campaign_id})


def list_campaign_views(campaign_id: str) -> Request[ViewList]:
    """The views of a campaign with the networks' first answers, and why some are not attacked."""
    return Request("GET", "/v1/campaigns/{campaign_id}/views", {"campaign_id": campaign_id})


def list_campaign_jobs(
    campaign_id: str, *, limit: int | None = None, after: int | None = None
) -> Request[CampaignJobPage]:
    """A page of a campaign's planned jobs, with numbers above `after`."""
    path, params = {"campaign_id": campaign_id}, {"limit": limit, "after": after}
    return Request("GET", "/v1/campaigns/{campaign_id}/jobs", path, params)


def get_campaign_table(campaign_id: str) -> Request[CampaignResult]:
    """The table, the mean curves and the views of a campaign."""
    return Request("GET", "/v1/campaigns/{campaign_id}/table.json", {"campaign_id": campaign_id})


def get_campaign_table_csv(campaign_id: str) -> Request[str]:
    """The table of a campaign as CSV."""
    return Request("GET", "/v1/campaigns/{campaign_id}/table.csv", {"campaign_id": campaign_id})


def get_campaign_table_latex(campaign_id: str) -> Request[str]:
    """The table of a campaign as LaTeX."""
    return Request("GET", "/v1/campaigns/{campaign_id}/table.tex", {"campaign_id": campaign_id})


def get_campaign_cases_csv(campaign_id: str) -> Request[str]:
    """The jobs of a campaign that have ended, as CSV."""
    return Request("GET", "/v1/campaigns/{campaign_id}/cases.csv", {"campaign_id": campaign_id})
