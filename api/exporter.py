"""The process that makes exports of jobs and glTF files of assets, and the files that it makes."""

import os
from collections.abc import Mapping
from io import BufferedReader
from pathlib import Path
from tempfile import mkstemp
from typing import Any

from fastapi import HTTPException

from api.warm_process import TooSlow, Unavailable, WarmProcess
from services.export import ASSET
from services.jobs.child import ChildDied, OutOfMemory
from services.settings import Settings

SECONDS = 120.0
"""Longest time for one export, after which the process is killed."""
MAX_WAITING = 16
"""Exports that may wait for the process or be in it."""


class Exporter:
    """A warm process that makes one export at a time. It starts with the first request and stays."""

    def __init__(self, settings: Settings) -> None:
        self._process = WarmProcess(settings, "services.jobs.export_process")
        self._waiting = 0

    def close(self) -> None:
        """Ends the process."""
        self._process.close()

    async def made(self, what: str, job_id: str, artifacts: Mapping[str, str]) -> BufferedReader:
        """The open file of an export, which has no name any more: all of it (`BUNDLE`), or the scene "before" or
        "after".

        `artifacts` are the SHA-256 of the job's files by name. Raises Unavailable, and HTTPException(409) for a job
        that cannot be exported.
        """
        return await self._file({"what": what, "job": job_id, "artifacts": dict(artifacts)}, "job cannot be exported")

    async def asset(self, mesh: str) -> BufferedReader:
        """The open glTF file of the scene of one mesh. Raises as `made` does."""
        return await self._file({"what": ASSET, "mesh": mesh}, "asset cannot be shown")

    async def _file(self, message: dict[str, Any], refusal: str) -> BufferedReader:
        if self._waiting >= MAX_WAITING:
            raise Unavailable("too many exports wait already; try again")
        self._waiting += 1
        handle, path = mkstemp(prefix="scene-attack-export-")
        os.close(handle)
        try:
            answer = await self._process.ask(message | {"out": path}, None, SECONDS)
            if "refused" in answer:
                raise HTTPException(409, f"the {refusal}: {answer['refused']}")
            if "failed" in answer:
                raise Unavailable(f"the export failed: {answer['failed']}")
            return Path(path).open("rb")
        except OutOfMemory as error:
            raise Unavailable(f"the export failed: it needs {error}") from error
        except (ChildDied, TooSlow) as error:
            raise Unavailable(f"the export did not end within {SECONDS:g} seconds and the memory allowed") from error
        finally:
            self._waiting -= 1
            os.unlink(path)
