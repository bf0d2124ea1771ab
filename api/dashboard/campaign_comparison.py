"""The page that compares campaigns: their tables side by side, what differs in their requests, and their curves."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Query, Response

from api.authentication import CallerDependency
from api.dashboard.campaigns import ALONG, Along, corners, end, points, steps
from api.dashboard.charts import Overlay, overlay
from api.dashboard.comparison import LETTERS, differences, named
from api.dashboard.pages import html
from api.state import ServicesDependency, no_such
from services.analysis.campaign_table import Cell, Table
from services.jobs.models import Campaign

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class ComparedCampaign:
    """A campaign of the comparison, and its table."""

    campaign: Campaign
    letter: str
    table: Table


@dataclass(frozen=True)
class CampaignRow:
    """One attack on one target in every campaign."""

    target: str
    attack: str
    cells: list[Cell | None]
    """For each campaign; None if it does not combine the two, or none of its cases has ended."""
    chart: Overlay | None
    corners: list[list[tuple[float, int, float]]]
    """The curve of each campaign as a table: work, successes, and their share."""


@router.get("/compare/campaigns")
def compare_campaigns(
    services: ServicesDependency,
    caller: CallerDependency,
    campaigns: Annotated[str, Query(max_length=1000, description="ids, separated by commas")] = "",
    campaign: Annotated[list[str], Query(max_length=200)] = [],  # noqa: B006 - the framework copies it
    against: Along = "queries",
) -> Response:
    """Compares two to eight campaigns, named by `campaigns` or, as a form sends ticked boxes, by several `campaign`."""
    ids = named(campaigns, campaign, "campaigns, as in /compare/campaigns?campaigns=a,b")
    compared = []
    for letter, campaign_id in zip(LETTERS, ids, strict=False):
        found = caller.visible(services.campaigns.record.get(campaign_id, whole=True))
        if found is None:
            raise no_such(f"campaign as {campaign_id}")
        compared.append(ComparedCampaign(found, letter, services.campaigns.result(found, curves=False).table))
    return html(
        "compare_campaigns.html",
        caller=caller,
        compared=compared,
        ids=",".join(ids),
        against=against,
        along=ALONG,
        rows=campaign_rows(compared, against),
        differing=differences([one.campaign.spec for one in compared]),
    )


def campaign_rows(compared: Sequence[ComparedCampaign], against: Along) -> list[CampaignRow]:
    """A row for each target and attack of any campaign, in the order in which they first occur."""
    pairs = dict.fromkeys((cell.target, cell.attack) for one in compared for cell in one.table.cells)
    return [_campaign_row(compared, target, attack, against) for target, attack in pairs]


def _campaign_row(compared: Sequence[ComparedCampaign], target: str, attack: str, against: Along) -> CampaignRow:
    found = [one.table.cell(target, attack) for one in compared]
    cells = [cell if cell and cell.success.of else None for cell in found]
    until = 1.05 * max((end(cell, against) for cell in cells if cell), default=0.0) or 1.0
    curves = [
        (one.letter, points(cell, against, until) if cell else []) for one, cell in zip(compared, cells, strict=True)
    ]
    return CampaignRow(
        target=target,
        attack=attack,
        cells=cells,
        chart=overlay(f"{attack}, {target}: verified successes, % of all cases", ALONG[against], curves),
        corners=[steps(corners(cell, against), cell.success.of) if cell else [] for cell in cells],
    )
