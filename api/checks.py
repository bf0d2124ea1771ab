"""Work that the API gives its warm processes: checks and previews of requests, and exports."""

import os
from collections.abc import Callable, Mapping
from io import BufferedReader
from pathlib import Path
from tempfile import mkstemp
from typing import Any

from fastapi import HTTPException
from starlette.concurrency import run_in_threadpool

from api.warm_pool import NoneFree, TooSlow, Unavailable, WarmPool
from services.access.caller import Caller
from services.errors import InvalidRequest
from services.export import ASSET
from services.jobs.processes import ChildDied, OutOfMemory
from services.names import Names
from services.pipeline.campaign_spec import CampaignSpec
from services.pipeline.check import Checked, check_names, check_size, placed, samples
from services.pipeline.preview_record import PlannedCost, Preview
from services.pipeline.result import JobWarning
from services.pipeline.spec import JobSpec, digest
from services.settings import Settings

WAITING_SHARE = 0.1
"""Longest wait of a check for a process, as a share of the time that it may take: 0.5 seconds by default."""
PREVIEW_SHARE = 2
"""Longest preview, longest plan and longest wait for either, as a multiple of the time that a check may take."""
EXPORT_SECONDS = 120.0
"""Longest time for one export, and longest wait for those before it."""
MOST_SLOW = 1000
"""Number of requests that are remembered since their check took too long."""
TOO_LARGE = "ask for a smaller image, a smaller environment map or fewer objects"


class Checks:
    """Checks requests before they are accepted. Nothing of a request is checked anywhere else."""

    def __init__(self, pool: WarmPool, names: Callable[[Caller], Names], settings: Settings) -> None:
        """names: the names that a request of a caller may have."""
        self._pool = pool
        self._names = names
        self._settings = settings
        self._slow: dict[str, None] = {}
        """Digests of requests whose check took too long, of which the newest are kept: a worker checks the next one."""

    async def check(self, spec: JobSpec, caller: Caller) -> Checked | None:
        """Returns the request as it would run, and warnings; None if that could not be found out in time.

        Raises InvalidRequest if it cannot run, and Unavailable.
        """
        await run_in_threadpool(lambda: check_names(spec, self._names(caller)))
        return await self._check(spec)

    async def check_campaign(self, campaign: CampaignSpec, caller: Caller) -> None:
        """Checks the size of a campaign, its names, and one job of each kind. Raises as `check` does."""
        check_size(campaign)
        await run_in_threadpool(lambda: check_names(campaign, self._names(caller)))
        for spec, places in await run_in_threadpool(lambda: list(samples(campaign))):
            try:
                await self._check(spec)
            except InvalidRequest as error:
                raise placed(error, places) from error

    async def preview(self, spec: JobSpec, caller: Caller, client: str) -> tuple[Preview, str]:
        """Returns a request's preview, and the image of its scene as a PNG file in base64.

        Raises InvalidRequest if the request cannot run, HTTPException(413) if that takes too long, and Unavailable.
        """
        await run_in_threadpool(lambda: check_names(spec, self._names(caller)))
        answer = await self._preview("preview", spec, client)
        return Preview.model_validate(answer["preview"]), answer["png"]

    async def plan(self, spec: JobSpec, client: str) -> PlannedCost:
        """Returns the plan of a request that was previewed, and its cost. Raises as `preview` does."""
        return PlannedCost.model_validate(await self._preview("plan", spec, client))

    async def _check(self, spec: JobSpec) -> Checked | None:
        seconds, without_seed = self._settings.check_seconds, digest(spec.model_copy(update={"seed": 0}))
        if without_seed in self._slow:
            return None
        try:
            message = {"check": spec.model_dump(mode="json")}
            answer = await self._pool.check(message, WAITING_SHARE * seconds, seconds)
        except NoneFree:
            return None
        except TooSlow:
            self._slow[without_seed] = None
            if len(self._slow) > MOST_SLOW:
                del self._slow[next(iter(self._slow))]
            return None
        except ChildDied as error:
            raise Unavailable("the check of this request was cut short; try again") from error
        except OutOfMemory as error:
            raise _too_large(error) from error
        warnings = tuple(JobWarning.model_validate(warning) for warning in answer["warnings"])
        return Checked(JobSpec.model_validate(answer["spec"]), warnings)

    async def _preview(self, what: str, spec: JobSpec, client: str) -> dict[str, Any]:
        seconds = PREVIEW_SHARE * self._settings.check_seconds
        try:
            return await self._pool.work({what: spec.model_dump(mode="json")}, client, seconds, seconds)
        except NoneFree as error:
            raise Unavailable(f"other previews took longer than {seconds:g} s; try again") from error
        except TooSlow as error:
            thing = "its plan" if what == "plan" else "its scene"
            shorter = ", or leave the plan out" if what == "plan" else ""
            detail = f"{thing} takes longer than the {seconds:g} s of a preview; ask for a smaller image, fewer objects"
            raise HTTPException(
                413, f"{detail} or smaller maps{shorter}. A job of this request may still run"
            ) from error
        except ChildDied as error:
            raise Unavailable("the preview was cut short; try again") from error
        except OutOfMemory as error:
            raise _too_large(error) from error


def _too_large(error: OutOfMemory) -> InvalidRequest:
    return InvalidRequest("scene", f"rendering it once takes {error}; {TOO_LARGE}")


class Exporter:
    """Makes exports of jobs and glTF files of assets, one at a time and together with previews."""

    def __init__(self, pool: WarmPool) -> None:
        self._pool = pool

    async def made(self, what: str, job_id: str, artifacts: Mapping[str, str], client: str) -> BufferedReader:
        """The open file of an export, which has no name any more: all of it (`BUNDLE`), or the scene "before" or
        "after".

        `artifacts` are the SHA-256 of the job's files by name. Raises Unavailable, and HTTPException(409) for a job
        that cannot be exported.
        """
        message = {"what": what, "job": job_id, "artifacts": dict(artifacts)}
        return await self._file(message, client, "job cannot be exported")

    async def asset(self, mesh: str, client: str) -> BufferedReader:
        """The open glTF file of the scene of one mesh. Raises as `made` does."""
        return await self._file({"what": ASSET, "mesh": mesh}, client, "asset cannot be shown")

    async def _file(self, message: dict[str, Any], client: str, refusal: str) -> BufferedReader:
        handle, path = mkstemp(prefix="scene-attack-export-")
        os.close(handle)
        try:
            export = {"export": message | {"out": path}}
            answer = await self._pool.work(export, client, EXPORT_SECONDS, EXPORT_SECONDS)
            if "refused" in answer:
                raise HTTPException(409, f"the {refusal}: {answer['refused']}")
            return Path(path).open("rb")
        except NoneFree as error:
            raise Unavailable("other exports take too long; try again") from error
        except OutOfMemory as error:
            raise Unavailable(f"the export failed: it needs {error}") from error
        except (ChildDied, TooSlow) as error:
            detail = f"the export did not end within {EXPORT_SECONDS:g} seconds and the memory allowed"
            raise Unavailable(detail) from error
        finally:
            os.unlink(path)
