"""Takes uploaded meshes: a few at a time, each read in a process of its own, and clients in turn."""

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import BinaryIO, TypeVar

from scene_attack.errors import JobFailure
from scene_attack.logs import logger
from scene_attack.scenes.bundle import About, Bundle
from scene_attack.scenes.library import Entry, Library
from scene_attack.scenes.reading.isolated import AT_ONCE, reader
from scene_attack.scenes.uploads import max_unpacked, to_bundle
from scene_attack_api.warm_pool import MOST_OPEN, Turns, Unavailable
from scene_attack_service.settings import Settings

Found = TypeVar("Found")
Adding = Callable[[str, int, str | None], AbstractContextManager[None]]
"""Takes the name of a mesh, its size, bytes, and the name that people see, if it has one; what it gives is entered
while the mesh is read and stored."""

log = logger(__name__)


@dataclass(frozen=True)
class Sent:
    """Files that a client sent, each with its name: a mesh and what it names, or one zip file of them.

    kind: the format of the mesh, or None to take it from its name. mesh: the name of the mesh among several, or None.
    about: what the client says of it.
    """

    files: Sequence[tuple[str, BinaryIO]]
    kind: str | None
    mesh: str | None
    about: About


class MeshUploads:
    """The uploads that are being read, and those that wait. Used by one event loop."""

    def __init__(self, library: Library, limits: Settings) -> None:
        self._library = library
        self._limits = limits
        self._threads = ThreadPoolExecutor(AT_ONCE, "uploads")
        self._turns = Turns(AT_ONCE, MOST_OPEN)
        self._free = asyncio.Semaphore(AT_ONCE)

    def start(self) -> None:
        """Starts the process that reads files, without waiting until it is there; the first upload starts it too."""
        self._threads.submit(_start)

    def close(self) -> None:
        """Ends the process; uploads that wait are dropped."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        reader().close()

    async def add(self, sent: Sent, client: str, adding: Adding) -> Entry:
        """Checks and stores a mesh, while `adding` is entered with its name, size and title.

        Raises InvalidRequest("file", "kind" or "mesh"), and Unavailable.
        """
        return await self._in_turn(client, partial(self._add, sent, adding))

    async def check_image(self, data: bytes, size: tuple[int, int], client: str) -> None:
        """Reads an image. Raises InvalidRequest("image") unless its height and width are `size`, and Unavailable."""
        await self._in_turn(client, partial(reader().read_image, data, size))

    async def _in_turn(self, client: str, read: Callable[[], Found]) -> Found:
        try:
            async with self._turns.turn(client), self._free:
                return await asyncio.get_running_loop().run_in_executor(self._threads, read)
        except JobFailure as error:
            raise Unavailable(f"the file could not be read: {error.detail}") from error

    def _add(self, sent: Sent, adding: Adding) -> Entry:
        # Waiting uploads stay on the disk; only those whose turn it is are in memory.
        bundle = self._bundle(sent)
        with adding(f"sha256:{bundle.sha256}", bundle.size, bundle.about.title):
            return self._library.add(bundle, self._limits)

    def _bundle(self, sent: Sent) -> Bundle:
        read = []
        for name, file in sent.files:
            file.seek(0)
            read.append((name, file.read()))
        return to_bundle(read, sent.kind, sent.mesh, sent.about, max_unpacked(self._limits))


def _start() -> None:
    try:
        reader().start()
    except JobFailure as error:
        log.warning("files cannot be read yet", error=error.detail)
