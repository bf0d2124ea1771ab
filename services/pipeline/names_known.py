"""Checks the names in a request, without reading a file or rendering anything. It needs no torch."""

from collections.abc import Callable

from services.errors import InvalidRequest
from services.pipeline.spec import JobSpec
from services.targets.info import known


def check_names(spec: JobSpec, check_mesh: Callable[[str], None]) -> None:
    """Raises InvalidRequest with the path of an unknown mesh or target. The names of materials, attacks and renderers
    belong to the schema. `check_mesh` raises InvalidRequest("mesh") for the name of an unknown mesh.
    """
    known(spec.target.name)
    check_meshes(spec, check_mesh)


def check_meshes(spec: JobSpec, check: Callable[[str], None]) -> None:
    """Calls `check` with the name of every mesh, and of an environment map that is an upload. It raises
    InvalidRequest("mesh") for one that may not be named, which is raised again with its path in the request.
    """
    for index, thing in enumerate(spec.scene.objects):
        try:
            check(thing.mesh)
        except InvalidRequest as error:
            raise InvalidRequest(f"scene.objects.{index}.mesh", error.detail) from error
    environment = spec.scene.lights.environment.map
    if environment.startswith("sha256:"):
        try:
            check(environment)
        except InvalidRequest as error:
            detail = f"there is no environment map {environment!r}, or it is no upload of yours"
            raise InvalidRequest("scene.lights.environment.map", detail) from error
