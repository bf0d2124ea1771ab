"""Checks specs in other processes, so that the API itself uses neither OpenGL nor torch."""

from api.check_pool import CheckPool, NoneFree, Request
from api.warm_process import TooSlow, WarmProcess
from services.pipeline.checked import Checked
from services.pipeline.spec import JobSpec, digest
from services.pipeline.warning import JobWarning
from services.settings import Settings


class Preflight:
    """The processes that check specs."""

    def __init__(self, settings: Settings) -> None:
        processes = [WarmProcess(settings) for _ in range(settings.check_processes)]
        self.specs = CheckPool(processes, settings.check_wait_seconds, settings.check_seconds)

    def start(self) -> None:
        """Starts the processes that check specs, without waiting until they are warm."""
        self.specs.start()

    def close(self) -> None:
        """Ends the processes; waiting requests are dropped."""
        self.specs.close()

    async def check(self, spec: JobSpec, client: str) -> Checked | None:
        """Returns the spec as it would run, and warnings; None if that could not be found out in time.

        Specs that differ in their seed alone share one check. Raises InvalidRequest if it cannot run, and Unavailable.
        """
        try:
            found = await self.specs.check(request_for("check", spec), client)
        except (NoneFree, TooSlow):
            return None
        warnings = tuple(JobWarning.model_validate(one) for one in found["warnings"])
        return Checked(JobSpec.model_validate(found["spec"] | {"seed": spec.seed}), warnings)


def request_for(what: str, spec: JobSpec) -> Request:
    """The request to a process to do `what` with a spec; equal for specs that differ in their seed alone."""
    height, width = spec.scene.camera.size
    cost = height * width * (1 + len(spec.scene.objects))
    key = f"{what} {digest(spec.model_copy(update={'seed': 0}))}"
    return Request(key, {what: spec.model_dump(mode="json")}, cost)
