"""Previews requests in a process of its own, so that a preview does not delay the check of a job.

The process starts with the first preview and stays. Clients take turns as they do for checks.
"""

from typing import Any

from fastapi import HTTPException

from api.check_pool import CheckPool, NoneFree
from api.preflight import request_for
from api.warm_process import TooSlow, Unavailable, WarmProcess
from services.pipeline.preview_record import PlannedCost, Preview
from services.pipeline.spec import JobSpec
from services.settings import Settings

REMEMBERED = 16
"""Number of previews that are remembered; an image may have megabytes."""


class Previewer:
    """The process that previews requests, one at a time."""

    def __init__(self, settings: Settings) -> None:
        seconds = settings.preview_seconds
        self._pool = CheckPool([WarmProcess(settings)], seconds, seconds, REMEMBERED)
        self._started = False

    def start(self) -> None:
        """Starts the process if it was not started yet, without waiting until it is warm."""
        if not self._started:
            self._started = True
            self._pool.start()

    def close(self) -> None:
        """Ends the process; waiting requests are dropped."""
        self._pool.close()

    async def preview(self, spec: JobSpec, client: str) -> tuple[Preview, str]:
        """Returns a request's preview, and the image of its scene as a PNG file in base64.

        Raises InvalidRequest if the request cannot run, HTTPException(413) if that takes too long, and Unavailable.
        """
        found = await self._asked("preview", spec, client)
        shown = Preview.model_validate(found["preview"])
        return shown.model_copy(update={"spec": shown.spec.model_copy(update={"seed": spec.seed})}), found["png"]

    async def plan(self, spec: JobSpec, client: str) -> PlannedCost:
        """Returns a request's plan and its cost. Raises as `preview` does."""
        return PlannedCost.model_validate(await self._asked("plan", spec, client))

    async def _asked(self, what: str, spec: JobSpec, client: str) -> dict[str, Any]:
        self.start()
        seconds = self._pool.seconds
        try:
            return await self._pool.check(request_for(what, spec), client)
        except NoneFree as error:
            raise Unavailable(f"other previews took longer than {seconds:g} s; try again") from error
        except TooSlow as error:
            thing = "its plan" if what == "plan" else "its scene"
            shorter = ", or leave the plan out" if what == "plan" else ""
            detail = f"{thing} takes longer than the {seconds:g} s of a preview; ask for a smaller image, fewer objects"
            raise HTTPException(
                413, f"{detail} or smaller maps{shorter}. A job of this request may still run"
            ) from error
