"""Routes that list the names a request can use: meshes, environment maps, targets."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from api.authentication import CallerDependency
from api.schemas import SceneLibrary, TargetList
from api.state import ServicesDependency
from services.targets.info import available

router = APIRouter(prefix="/v1")

Filter = Annotated[str | None, Query(max_length=200)]


@router.get("/scenes", tags=["assets"], response_model=SceneLibrary)
def get_scene_library(
    services: ServicesDependency,
    caller: CallerDependency,
    category: Filter = None,
    creator: Filter = None,
    licence: Filter = None,
    search: Filter = None,
) -> Response:
    """Lists the meshes that match all given filters, the environment maps, of uploads those that match, and their
    credits.
    """
    found = services.library.entries(category, creator, licence, search, services.assets.visible(caller))
    meshes = [entry for entry in found if entry.kind != "environment"]
    uploaded_maps = [entry for entry in found if entry.kind == "environment"]
    environments = [*services.library.environments(), *uploaded_maps]
    credits_ = {entry.credit for entry in [*meshes, *environments] if entry.credit is not None}
    listed = SceneLibrary(meshes=meshes, environments=environments, credits=sorted(credits_))
    return Response(listed.model_dump_json(), media_type="application/json")  # the framework would validate it again


@router.get("/targets", tags=["targets"])
def list_targets() -> TargetList:
    """Lists the networks that can be attacked."""
    return TargetList(items=available())
