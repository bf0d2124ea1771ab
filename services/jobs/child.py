"""A child process that stays warm, answers requests over a pipe, and never outlives its parent.

It is spawned as a fresh interpreter, because a fork hangs after its parent has used OpenGL or torch. A message is a
JSON object.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import Thread, Timer
from typing import Any

from services.confinement.system_calls import die_with_parent
from services.jobs.memory_limit import memory_limit, more_than
from services.jobs.stillness import Stillness
from services.settings import Settings

ALLOCATOR = {
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(8 * 2**30),
    "MALLOC_TOP_PAD_": str(256 * 2**20),
}
"""Settings with which glibc keeps large freed blocks. By default it returns them to the system at once, and page faults
raise the CPU time of a pass of 28 images from 370 to 560 ms. glibc reads them at start, so the parent sets them."""


SEND_SECONDS = 30.0
"""Time after which a child that does not take a request, since it hangs, is killed."""


LOOK_SECONDS = 0.1
"""Longest time between two looks at the memory of a child that works on a request."""
OUT_OF_MEMORY = {"out_of_memory": True}
"""The answer to a request that needs more memory than the child may have."""


_RESIDENT = re.compile(r"^Rss(?:Anon|Shmem):\s*(\d+) kB$", re.MULTILINE)
"""Memory that only the end of a process gives back, in /proc/PID/status."""


class ChildDied(Exception):
    """The child process has ended, so no answer will come."""


class OutOfMemory(Exception):
    """The child needed more memory than it may have; the message says how much that is."""


class Child:
    """The parent's end of the pipe. Only `end` is thread-safe, and only one request may be open at a time.

    The child runs `python -m module`, which reads requests with `requests()` and answers with `reply()`. It limits its
    own data (`limit_memory`); what that does not count, such as shared memory, is looked at from here.
    """

    def __init__(self, module: str, settings: Settings) -> None:
        ours, theirs = Pipe()
        environ = os.environ | settings.environ() | ALLOCATOR
        self._connection = ours
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env=environ,
            stdin=subprocess.DEVNULL,
            stdout=sys.__stderr__,
            start_new_session=True,  # a Ctrl-C is for the supervisor to handle
        )
        theirs.close()
        self._ended = False
        self._stillness = Stillness(self.pid)
        self.limit = memory_limit(settings)

    @property
    def pid(self) -> int:
        """The child's process id."""
        return self._process.pid

    def alive(self) -> bool:
        """Whether the child still runs."""
        return not self._ended and self._process.poll() is None

    def memory(self) -> int:
        """The child's resident memory in bytes, or 0 once it has ended.

        Shared memory counts. Pages of files do not: the kernel can drop them at any time.
        """
        try:
            status = Path(f"/proc/{self.pid}/status").read_text()
        except OSError:
            return 0
        return 1024 * sum(int(size) for size in _RESIDENT.findall(status))

    def still_seconds(self) -> float:
        """How long the child has done nothing, in seconds; see `Stillness`."""
        return self._stillness.seconds()

    def send(self, message: dict[str, Any]) -> None:
        """Sends a request. Raises ChildDied."""
        self._stillness = Stillness(self.pid)
        limit = Timer(SEND_SECONDS, self.end)  # the pipe holds less than a large request
        limit.start()
        try:
            self._connection.send_bytes(json.dumps(message).encode())
        except OSError as error:
            raise ChildDied from error
        finally:
            limit.cancel()

    def receive(self, seconds: float) -> dict[str, Any] | None:
        """Returns the next answer, or None if none comes within `seconds`.

        Raises ChildDied, and OutOfMemory if the child says so, or has too much memory and is killed.
        """
        deadline = time.monotonic() + seconds
        try:
            while not self._connection.poll(min(LOOK_SECONDS, max(0.0, deadline - time.monotonic()))):
                if self.memory() > self.limit:
                    self.end()  # the caller waits for it: freeing gigabytes takes seconds
                    raise OutOfMemory(more_than(self.limit))
                if time.monotonic() >= deadline:
                    return None
            answer: dict[str, Any] = json.loads(self._connection.recv_bytes())
        except (EOFError, OSError) as error:
            raise ChildDied from error
        if answer == OUT_OF_MEMORY:
            raise OutOfMemory(more_than(self.limit))
        return answer

    def end(self) -> None:
        """Kills the child and what it has started, from any thread. A thread that waits in `receive` gets ChildDied."""
        self._ended = True
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)  # the child leads a group, which its own children are in

    def kill(self) -> int:
        """Kills the child and waits until it has ended. Returns its exit status, negative for a signal."""
        self.end()
        self._connection.close()
        return self._process.wait()


def connect() -> Connection:
    """Returns the child's end of the pipe, whose file descriptor is the command line's first argument.

    From then on the child ends with its parent's thread that started it, even if it hangs.
    """
    die_with_parent()
    return Connection(int(sys.argv[1]))


def requests(connection: Connection) -> Iterator[dict[str, Any]]:
    """Yields requests as they come. The process exits at once when its parent has ended."""
    inbox: SimpleQueue[bytes] = SimpleQueue()
    Thread(target=_read, args=(connection, inbox), daemon=True).start()
    while True:
        yield json.loads(inbox.get())


def _read(connection: Connection, inbox: "SimpleQueue[bytes]") -> None:
    try:
        while True:
            inbox.put(connection.recv_bytes())
    except (EOFError, OSError):
        os._exit(0)


def reply(connection: Connection, message: dict[str, Any]) -> None:
    """Sends an answer to the parent."""
    connection.send_bytes(json.dumps(message).encode())
