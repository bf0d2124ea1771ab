"""Checks the names in a request, without reading a file or rendering anything. It needs no torch."""

from services.errors import InvalidRequest
from services.pipeline.spec import JobSpec
from services.scenes.library import Library
from services.targets.info import known


def check_names(spec: JobSpec, library: Library) -> None:
    """Raises InvalidRequest with the path of an unknown mesh or target. The names of materials, attacks and renderers
    belong to the schema.
    """
    known(spec.target.name)
    for index, thing in enumerate(spec.scene.objects):
        try:
            library.check_mesh(thing.mesh)
        except InvalidRequest as error:
            raise InvalidRequest(f"scene.objects.{index}.mesh", error.detail) from error
