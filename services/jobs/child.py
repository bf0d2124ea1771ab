"""A process of our own that stays warm, answers requests over a pipe, and never outlives its parent.

It is spawned as a fresh interpreter: a fork after OpenGL or torch was touched hangs. A message is a JSON object and,
where files are sent, bytes after it.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import Any

from services.settings import Settings

ALLOCATOR = {
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(8 * 2**30),
    "MALLOC_TOP_PAD_": str(256 * 2**20),
}
"""glibc gives large blocks back to the system at once; a pass of 28 images then takes 560 ms of CPU time instead of
370, spent in page faults. These keep them. Read at start only, so a parent sets them."""


class ChildDied(Exception):
    """The child is gone; there will be no answer."""


class Child:
    """The parent's end. Not thread-safe; one request at a time.

    `module` is run with `python -m`; it calls `requests()` and answers with `reply()`.
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

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def memory(self) -> int:
        """Resident bytes; 0 once it is dead."""
        try:
            with open(f"/proc/{self.pid}/statm") as file:
                return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        except (OSError, IndexError):
            return 0

    def send(self, message: dict[str, Any], data: bytes = b"") -> None:
        """Send a request. Raises ChildDied."""
        try:
            self._connection.send_bytes(json.dumps(message).encode() + b"\n" + data)
        except OSError as error:
            raise ChildDied from error

    def receive(self, seconds: float) -> dict[str, Any] | None:
        """The next answer, or None if there is none within so many seconds. Raises ChildDied."""
        try:
            if not self._connection.poll(seconds):
                return None
            answer: dict[str, Any] = json.loads(self._connection.recv_bytes())
            return answer
        except (EOFError, OSError) as error:
            raise ChildDied from error

    def end(self) -> None:
        """Have it killed, from any thread: whoever waits for its answer is told that it died."""
        self._process.kill()

    def kill(self) -> int:
        """End it at once and wait until it is gone. Returns its exit status, negative for a signal."""
        self._process.kill()
        self._connection.close()
        return self._process.wait()


def connect() -> Connection:
    """The child's end, from the command line its parent gave it."""
    return Connection(int(sys.argv[1]))


def requests(connection: Connection) -> Iterator[tuple[dict[str, Any], bytes]]:
    """Requests as they come. When the parent is gone the process ends at once, whatever it was doing."""
    inbox: SimpleQueue[bytes] = SimpleQueue()
    Thread(target=_read, args=(connection, inbox), daemon=True).start()
    while True:
        head, _, data = inbox.get().partition(b"\n")
        yield json.loads(head), data


def _read(connection: Connection, inbox: "SimpleQueue[bytes]") -> None:
    try:
        while True:
            inbox.put(connection.recv_bytes())
    except (EOFError, OSError):
        os._exit(0)


def reply(connection: Connection, message: dict[str, Any]) -> None:
    """Answer the parent."""
    connection.send_bytes(json.dumps(message).encode())
