"""Looks up the names in a request, without reading a file or rendering anything. It needs no torch."""

from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType

from services.errors import InvalidRequest
from services.names import Names
from services.pipeline.campaign_spec import CampaignSpec
from services.pipeline.campaign_spec import parse as parse_campaign
from services.pipeline.spec import JobSpec
from services.pipeline.spec import parse as parse_job
from services.rendering.torch_renderer.preset_names import check_preset
from services.scenes.description import Scene
from services.scenes.library import Library
from services.targets.download import check_obtainable


def names_in(
    library: Library,
    may_use: Callable[[str], bool] = lambda _: True,
    not_read: Mapping[str, str] = MappingProxyType({}),
) -> Names:
    """Returns the context with which a request is validated together with the names in it.

    An upload for whose name `may_use` is false is unknown. `not_read` says of meshes that are files of this machine why
    they could not be added.
    """

    def check_mesh(name: str) -> None:
        if name in not_read:
            raise InvalidRequest("mesh", not_read[name])
        library.check_mesh(name, may_use)

    # A campaign names the same few things in each of thousands of jobs.
    return {
        "mesh": cache(check_mesh),
        "map": cache(lambda name: library.check_map(name, may_use)),
        "material": check_preset,
        "target": cache(check_obtainable),
    }


def check_names(request: JobSpec | CampaignSpec, names: Names) -> None:
    """Raises InvalidFields with every name in a valid request that there is not."""
    parse = parse_job if isinstance(request, JobSpec) else parse_campaign
    parse(request.model_dump(mode="json"), names)


def check_meshes(scene: Scene, check: Callable[[str], None]) -> None:
    """Calls `check` with the name of every mesh, and of an environment map that is an upload. It raises
    InvalidRequest("mesh") for one that may not be named, which is raised again with its path in the request.
    """
    for index, thing in enumerate(scene.objects):
        try:
            check(thing.mesh)
        except InvalidRequest as error:
            raise InvalidRequest(f"scene.objects.{index}.mesh", error.detail) from error
    environment = scene.lights.environment.map
    if environment.startswith("sha256:"):
        try:
            check(environment)
        except InvalidRequest as error:
            detail = f"there is no environment map {environment!r}, or it is no upload of yours"
            raise InvalidRequest("scene.lights.environment.map", detail) from error
