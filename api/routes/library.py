"""Routes that list the names a request can use: meshes, environment maps, targets."""

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel

from api.authentication import CallerDependency
from api.schemas import SceneLibrary
from api.state import ServicesDependency
from services.targets.info import TargetInfo, available

router = APIRouter(prefix="/v1", tags=["scenes"])

Filter = Annotated[str | None, Query(max_length=200)]


class TargetList(BaseModel):
    """The networks that can be attacked."""

    items: list[TargetInfo]


@router.get("/scenes")
def scenes(
    services: ServicesDependency,
    caller: CallerDependency,
    category: Filter = None,
    creator: Filter = None,
    licence: Filter = None,
    search: Filter = None,
) -> SceneLibrary:
    """Lists the meshes that match all given filters, the environment maps, and their credits."""
    is_visible = services.assets.visible(caller)
    found = services.library.entries(category=category, creator=creator, licence=licence, search=search)
    meshes = [entry for entry in found if entry.kind != "upload" or is_visible(entry.name)]
    environments = services.library.environments()
    credits_ = {entry.credit for entry in [*meshes, *environments] if entry.credit is not None}
    return SceneLibrary(meshes=meshes, environments=environments, credits=sorted(credits_))


@router.get("/targets")
def targets() -> TargetList:
    """Lists the networks that can be attacked."""
    return TargetList(items=available())
