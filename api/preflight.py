"""Checks specs and meshes in other processes, so that the API itself uses neither OpenGL nor torch."""

from typing import BinaryIO

from api.check_pool import CheckPool, Request
from api.warm_process import TooSlow, WarmProcess
from services.errors import InvalidRequest
from services.jobs.child import ChildDied
from services.pipeline.checked import Checked
from services.pipeline.spec import JobSpec, digest
from services.pipeline.warning import JobWarning
from services.scenes.library import Entry
from services.settings import Settings

MESH_SECONDS = 30.0
"""Longest time for parsing an uploaded mesh, after which the process is killed."""


class Preflight:
    """The processes that check specs, and one for meshes, which starts with the first upload."""

    def __init__(self, settings: Settings) -> None:
        processes = [WarmProcess(settings) for _ in range(settings.check_processes)]
        self.specs = CheckPool(processes, settings.check_wait_seconds, settings.check_seconds)
        self._meshes = WarmProcess(settings)

    def start(self) -> None:
        """Starts the processes that check specs, without waiting until they are warm."""
        self.specs.start()

    def close(self) -> None:
        """Ends the processes; waiting requests are dropped."""
        self.specs.close()
        self._meshes.close()

    async def check(self, spec: JobSpec, client: str) -> Checked | None:
        """Returns the spec as it would run, and warnings; None if that could not be found out in time.

        Specs that differ in their seed alone share one check. Raises InvalidRequest if it cannot run, and Unavailable.
        """
        height, width = spec.scene.camera.size
        cost = height * width * (1 + len(spec.scene.objects))
        key = digest(spec.model_copy(update={"seed": 0}))
        found = await self.specs.check(Request(key, {"check": spec.model_dump(mode="json")}, cost), client)
        if found is None:
            return None
        warnings = tuple(JobWarning.model_validate(one) for one in found["warnings"])
        return Checked(JobSpec.model_validate(found["spec"] | {"seed": spec.seed}), warnings)

    async def add_mesh(self, file: BinaryIO, kind: str) -> Entry:
        """Checks and stores an uploaded mesh of format `kind`. Raises InvalidRequest("file"), and Unavailable."""
        try:
            answer = await self._meshes.ask({"mesh": kind}, file, MESH_SECONDS)
        except (ChildDied, TooSlow) as error:
            detail = f"it could not be read within {MESH_SECONDS:g} seconds and the memory allowed"
            raise InvalidRequest("file", detail) from error
        return Entry.model_validate(answer["entry"])
