"""Sends requests to the preflight process, so that the API itself uses neither OpenGL nor torch and parses no mesh."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from typing import Any, BinaryIO

from services.errors import InvalidRequest
from services.jobs.child import Child, ChildDied
from services.logs import logger
from services.pipeline.spec import JobSpec
from services.pipeline.warning import JobWarning
from services.scenes.library import Entry
from services.settings import Settings

START_SECONDS = 180.0
CHECK_SECONDS = 120.0
"""Longest check of a spec, in which the scene is rendered and classified once."""
MESH_SECONDS = 30.0
"""Longest time for parsing an uploaded mesh, after which the process is killed."""
RERENDER_SECONDS = 300.0
"""Longest time for re-rendering an image, after which the process is killed."""

log = logger(__name__)


class Unavailable(Exception):
    """The check could not be completed; the client may try again."""


class Preflight:
    """The preflight process, which handles one request at a time and is restarted if it dies."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._child: Child | None = None
        # With one thread, requests wait for one another; the request of a client that disconnects still finishes.
        self._thread = ThreadPoolExecutor(1, "preflight")

    def start(self) -> None:
        """Starts the process, without waiting until it is warm."""
        self._thread.submit(self._warm)

    def close(self) -> None:
        """Ends the process; waiting requests are dropped."""
        child = self._child
        if child is not None:
            child.end()  # a request in progress gets ChildDied
        self._thread.shutdown(cancel_futures=True)
        if self._child is not None:
            self._child.kill()
            self._child = None

    async def check(self, spec: JobSpec) -> tuple[JobSpec, list[JobWarning]]:
        """Returns the spec as it would run, and warnings. Raises InvalidRequest if it cannot run, and Unavailable."""
        try:
            answer = await self._ask({"check": spec.model_dump(mode="json")}, None, CHECK_SECONDS)
        except ChildDied as error:
            raise Unavailable("the check of this request was cut short; try again") from error
        return JobSpec.model_validate(answer["spec"]), [JobWarning.model_validate(one) for one in answer["warnings"]]

    async def add_mesh(self, file: BinaryIO, kind: str) -> Entry:
        """Checks and stores an uploaded mesh of format `kind`. Raises InvalidRequest("file"), and Unavailable."""
        try:
            answer = await self._ask({"mesh": kind}, file, MESH_SECONDS)
        except ChildDied as error:
            detail = f"it could not be read within {MESH_SECONDS:g} seconds and the memory allowed"
            raise InvalidRequest("file", detail) from error
        return Entry.model_validate(answer["entry"])

    async def rerender(self, request: dict[str, Any], image: bytes) -> dict[str, Any]:
        """Applies the re-rendering defence. Raises InvalidRequest naming the field, and Unavailable."""
        try:
            return await self._ask({"rerender": request}, BytesIO(image), RERENDER_SECONDS)
        except ChildDied as error:
            detail = f"the fit did not end within {RERENDER_SECONDS:g} seconds and the memory allowed; ask for fewer"
            raise InvalidRequest("fit.steps", detail) from error

    async def _ask(self, message: dict[str, Any], file: BinaryIO | None, seconds: float) -> dict[str, Any]:
        loop = asyncio.get_running_loop()
        answer = await loop.run_in_executor(self._thread, self._ask_now, message, file, seconds)
        if "field" in answer:
            raise InvalidRequest(answer["field"], answer["detail"])
        if "trouble" in answer:
            raise Unavailable(f"the check of this request failed: {answer['trouble']}")
        return answer

    def _ask_now(self, message: dict[str, Any], file: BinaryIO | None, seconds: float) -> dict[str, Any]:
        child = self._warm()
        try:
            # Waiting uploads stay on the disk; only the file of this request is read into memory.
            child.send(message, b"" if file is None else file.read())
            answer = child.receive(seconds)
            if answer is not None:
                return answer
            raise ChildDied
        except ChildDied:
            log.warning("preflight process died or was too slow", pid=child.pid)
            child.kill()
            self._child = None
            raise

    def _warm(self) -> Child:
        if self._child is not None and self._child.alive():
            return self._child
        if self._child is not None:
            self._child.kill()
        child = self._child = Child("services.jobs.preflight_process", self._settings)
        try:
            ready = child.receive(START_SECONDS)
        except ChildDied:
            ready = None
        if ready is None:
            child.kill()
            self._child = None
            raise Unavailable("the process that checks requests does not start; the service's log says why")
        log.info("preflight process ready", pid=child.pid)
        return child
