"""The warm processes of the service: a child that answers requests over a pipe and never outlives its parent, its
start-up, which is the same for all that render and classify, and the signs of life of programs.

A child is spawned as a fresh interpreter, because a fork hangs after its parent has used OpenGL or torch. A message is
a JSON object. The parent limits its memory, so that all processes together fit the machine, and notices if it hangs.

A program says that it is alive from the loop whose standstill would be a fault, in the protocol of systemd (sd_notify),
to the one that keeps it running. It says nothing where no one listens.
"""

import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import Thread, Timer
from typing import Any

from scene_attack.confinement import die_with_parent, forbid_new_privileges
from scene_attack.process import ALLOCATOR, program
from scene_attack.runs.spec import DEFAULT_TARGET
from scene_attack.scenes.reading.isolated import READING_BYTES
from scene_attack_service.settings import Settings

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

    The child runs `program(module)`, which reads requests with `requests()` and answers with `reply()`. It limits its
    own data (`limit_memory`); what that does not count, such as shared memory, is looked at from here.
    """

    def __init__(self, module: str, settings: Settings) -> None:
        ours, theirs = Pipe()
        environ = os.environ | settings.environ() | ALLOCATOR
        self._connection = ours
        self._process = subprocess.Popen(
            program(module, str(theirs.fileno())),
            pass_fds=[theirs.fileno()],
            env=environ,
            stdin=subprocess.DEVNULL,
            stdout=sys.__stderr__,
            start_new_session=True,  # a Ctrl-C is for the supervisor to handle
        )
        theirs.close()
        self._ended = False
        self._hangs = HangDetector(self.pid)
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

    def idle_seconds(self) -> float:
        """Time in seconds for which the child has done nothing; see `HangDetector`."""
        return self._hangs.seconds()

    def send(self, message: dict[str, Any]) -> None:
        """Sends a request. Raises ChildDied."""
        self._hangs = HangDetector(self.pid)
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


MEASURE_SECONDS = 1.0
"""Shortest time between two measurements."""
LONGEST_GAP = 2.0
"""A longer gap between two measurements means that this process, or the machine, was suspended."""
SIGN_SECONDS = 0.05
"""Processor time that is a sign of life. A process that polls every second uses less in the time allowed."""
_TICKS = os.sysconf("SC_CLK_TCK")


class HangDetector:
    """Measures how long the processes of a session have done nothing. `session` is the process id of its leader.

    A process that is stopped or deadlocked, or waits for an answer that never comes, uses no processor time; a
    computation does, however long it takes.
    """

    def __init__(self, session: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._session = session
        self._clock = clock
        self._looked = clock()
        self._used = processor_seconds(session)
        self._still = 0.0

    def seconds(self) -> float:
        """The time in seconds since the last sign of life, as far as the caller was awake to see it pass."""
        now = self._clock()
        gap = now - self._looked
        if gap >= MEASURE_SECONDS:
            self._looked = now
            used = processor_seconds(self._session)
            if abs(used - self._used) >= SIGN_SECONDS:
                self._used, self._still = used, 0.0
            else:
                self._still += min(gap, LONGEST_GAP)
        return self._still


def processor_seconds(session: int) -> float:
    """Processor time in seconds that the living processes of a session, and those they waited for, have used."""
    ticks = 0
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            with suppress(OSError):  # it has ended meanwhile
                fields = Path(entry.path, "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == session:
                    ticks += sum(int(value) for value in fields[11:15])
    return ticks / _TICKS


WARM_PROCESSES = 2
"""Processes of the API that render (`scene_attack_api.warm_pool`)."""
REST_BYTES = 2 * 2**30
"""Memory that the API, the workers, the supervisor, Redis and the system take, in bytes."""
LEAST_MEMORY, MOST_MEMORY = 4 * 2**30, 16 * 2**30
"""Bounds of the default. A warm process has 1.1 GB of data (1.4 GB with PyTorch's CUDA build), and 2.0 GB (2.3 GB) with
an image of 1024×1024 pixels."""


def memory_limit(values: Settings) -> int:
    """Bytes of memory of a job process, and of each of the two that check and preview requests and make exports.

    The default is an equal share of the machine's memory, after READING_BYTES and REST_BYTES.
    """
    if values.job_memory_bytes is not None:
        return values.job_memory_bytes
    processes = values.workers + WARM_PROCESSES
    share = (machine_memory() - READING_BYTES - REST_BYTES) // processes
    return min(max(share, LEAST_MEMORY), MOST_MEMORY)


def limit_memory(values: Settings) -> None:
    """Lets every allocation of this process fail that takes its data beyond the limit.

    Data is what the process may write and shares with nobody. Address space would not do: PyTorch's CUDA build reserves
    gigabytes of it that it never uses. Shared memory is not counted; the parent looks at it (`Child`).
    """
    limit = memory_limit(values)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def more_than(limit: int) -> str:
    """The end of a sentence about a process that needs more than `limit` bytes, with the setting that limits it."""
    return f"more memory than SCENE_ATTACK_JOB_MEMORY_BYTES allows a process, {limit / 2**30:.3g} GiB"


def machine_memory(limit: Path = Path("/sys/fs/cgroup/memory.max")) -> int:
    """Bytes of the machine's memory, or of the container's `limit` if that is less."""
    physical = os.sysconf("SC_PHYS_PAGES") * resource.getpagesize()
    try:
        return min(physical, int(limit.read_text()))
    except (OSError, ValueError):  # there is no control group, or it has no limit ("max")
        return physical


LIFE_SECONDS = 1.0
"""Shortest time between two signs."""

_said_alive = float("-inf")


def say_started() -> None:
    """Says that the program has started."""
    _notify("READY=1")


def say_alive() -> None:
    """Says that the program is alive; most calls within a second of the last one do nothing."""
    global _said_alive
    now = time.monotonic()
    if now - _said_alive >= LIFE_SECONDS:
        _said_alive = now
        _notify("WATCHDOG=1")


def _notify(message: str) -> None:
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address:
        # A listener that does not listen must not stop the program.
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender:
            sender.sendto(message.encode(), "\0" + address[1:] if address.startswith("@") else address)


class Listener:
    """Hears a program's signs of life. Its `environ` tells the program where to send them."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind("")  # the kernel chooses an abstract name
        name = self._socket.getsockname()
        assert isinstance(name, bytes)
        self.environ = {"NOTIFY_SOCKET": "@" + name[1:].decode()}

    def heard(self) -> bool:
        """Whether there was a sign since the last call."""
        heard = False
        with suppress(BlockingIOError):
            while self._socket.recv(4096):
                heard = True
        return heard

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()


NICENESS = 10
"""Niceness of job processes. One of niceness 0 gets about nine times as much processor time: the API still answers."""
CHECKING = 5
"""Niceness of the processes that check and preview requests: before jobs, and after the API."""
AUTOGROUP = Path("/proc/self/autogroup")


def warm_up(values: Settings) -> str:
    """Sets up the process, limits its memory, forbids new privileges and core files, sets torch's threads, loads the
    default network and opens the OpenGL context.

    Returns the name of the OpenGL backend.
    """
    import torch  # the API reads this module and must load no torch

    from scene_attack.rendering.opengl.context import gl_backend
    from scene_attack.runs.set_up import log_plugins, set_up
    from scene_attack.targets import registry

    set_up(values)
    limit_memory(values)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    forbid_new_privileges()
    torch.set_num_threads(values.threads)
    log_plugins()
    registry.load(DEFAULT_TARGET)
    return gl_backend()


def give_way(niceness: int = NICENESS) -> None:
    """Lets processes of ordinary niceness go first, from now on. Alone on the machine, this one runs as fast as before.

    Linux may share the processor between sessions first (autogroups), so that the niceness of the session counts.
    """
    os.nice(niceness)
    with suppress(OSError):  # a kernel without autogroups
        AUTOGROUP.write_text(str(niceness))
