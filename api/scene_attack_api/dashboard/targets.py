"""Route of the dashboard's page about the networks that can be attacked."""

from fastapi import APIRouter, Response

from scene_attack.targets.info import UNAVAILABLE, available
from scene_attack_api.dashboard.pages import html
from scene_attack_api.requests import CallerDependency, ServicesDependency
from scene_attack_service.jobs.statistics import TargetRecord

router = APIRouter(include_in_schema=False)


@router.get("/targets")
def targets(services: ServicesDependency, caller: CallerDependency) -> Response:
    """A card for each network."""
    records = services.record.targets.all(caller.only)
    cards = [(info, records.get(info.name, TargetRecord())) for info in available()]
    gone = sorted(set(records) - {info.name for info, _ in cards})
    others = [(name, records[name]) for name in gone]
    return html("targets.html", caller=caller, cards=cards, others=others, unavailable=sorted(UNAVAILABLE.items()))
