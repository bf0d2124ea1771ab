"""Takes uploaded meshes: a few at a time, each read in a process of its own, clients in turn and small files first."""

import asyncio
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import BinaryIO

from api.fair_queue import FairQueue
from api.warm_process import Unavailable
from services.errors import JobFailure
from services.logs import logger
from services.scenes.isolated_reading import AT_ONCE, reader
from services.scenes.library import Entry, Library
from services.scenes.uploads import name_of
from services.settings import Settings

Adding = Callable[[str], AbstractContextManager[None]]
"""Takes the name of a mesh; what it gives is entered while the mesh is read and stored."""

log = logger(__name__)


class MeshUploads:
    """The uploads that are being read, and those that wait. Used by one event loop."""

    def __init__(self, library: Library, limits: Settings) -> None:
        self._library = library
        self._limits = limits
        self._threads = ThreadPoolExecutor(AT_ONCE, "uploads")
        self._waiting: FairQueue[asyncio.Future[None]] = FairQueue()
        self._free = AT_ONCE

    def start(self) -> None:
        """Starts the process that reads files, without waiting until it is there; the first upload starts it too."""
        self._threads.submit(_start)

    def close(self) -> None:
        """Ends the process; uploads that wait are dropped."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        reader().close()

    async def add(self, file: BinaryIO, kind: str, client: str, adding: Adding) -> Entry:
        """Checks and stores a mesh of format `kind`, while `adding` is entered with its name.

        Raises InvalidRequest("file" or "kind"), and Unavailable.
        """
        loop = asyncio.get_running_loop()
        turn = loop.create_future()
        place = self._waiting.add(turn, client, file.seek(0, os.SEEK_END))
        self._admit()
        try:
            await turn
            return await loop.run_in_executor(self._threads, self._add, file, kind, adding)
        except JobFailure as error:
            raise Unavailable(f"the file could not be read: {error.detail}") from error
        finally:
            if not self._waiting.drop(place):
                self._waiting.done(place)
                self._free += 1
            self._admit()

    def _admit(self) -> None:
        while self._free and len(self._waiting):
            self._free -= 1
            turn = self._waiting.take().what
            if not turn.done():  # its client may have gone
                turn.set_result(None)

    def _add(self, file: BinaryIO, kind: str, adding: Adding) -> Entry:
        # Waiting uploads stay on the disk; only those whose turn it is are in memory.
        file.seek(0)
        data = file.read()
        with adding(f"sha256:{name_of(data, kind)}"):
            return self._library.add_mesh(data, kind, self._limits)


def _start() -> None:
    try:
        reader().start()
    except JobFailure as error:
        log.warning("files cannot be read yet", error=error.detail)
