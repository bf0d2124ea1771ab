"""`scene-attack serve`: runs Redis (unless a URL is set), the API and the workers; they start and stop together.

One data folder has one service, by a lock: two would take each other's jobs.
"""

import errno
import fcntl
import json
import os
import shutil
import socket
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import httpx
from redis import Redis
from redis.exceptions import RedisError
from sqlalchemy import Engine

from scene_attack.errors import InvalidRequest
from scene_attack.logs import configure, logger
from scene_attack.process import check_device, program
from scene_attack.runs.set_up import set_up
from scene_attack_service.access.keys import check_listening, listen
from scene_attack_service.jobs.database import connect as connect_database
from scene_attack_service.jobs.database import migrate
from scene_attack_service.jobs.queue import connect as connect_redis
from scene_attack_service.jobs.queue import find_server
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from scene_attack_worker.main import housekeeping, workers
from scene_attack_worker.supervisor import Program, Supervisor

log = logger(__name__)


def serve(values: Settings) -> int:
    """Runs the whole service until SIGTERM or SIGINT; prints "ready URL" once it takes jobs. Returns the exit status.

    Raises InvalidRequest if the address is taken or the device of the settings is not there, if other machines reach
    the address and there is no key, and if another service runs on the data folder.
    """
    set_up(values)  # the supervisor reads campaigns, whose fields may be a plug-in's
    check_device()
    if values.redis_url is not None:
        connect_redis(values.redis_url).close()  # refuses a URL that cannot be, before anything is made
    configure("supervisor")
    engine = connect_database(values)
    try:
        with ServiceLock(values.data_dir) as lock:  # before the database is migrated, which the other service uses
            check_listening(values)
            migrate(engine, values)
            _run(values, engine, lock)
    finally:
        engine.dispose()
    return 0


def _run(values: Settings, engine: Engine, lock: "ServiceLock") -> None:
    record = Record(engine)
    remove_abandoned()
    redis = EmbeddedRedis() if values.redis_url is None else None
    try:
        with listen(values.host, values.port) as listener:
            if values.redis_url is not None:
                _check_redis(values.redis_url)
            port = listener.getsockname()[1]
            url = values.redis_url if redis is None else redis.url
            values = values.model_copy(update={"port": port, "redis_url": url})
            programs = [] if redis is None else [redis.program()]
            programs += [_api(values, listener), *workers(values, record)]
            tidy = housekeeping(values, record)
            address = f"http://{_reachable(values.host)}:{port}"
            lock.tell(address)
            announce = _Announcement(address)

            def duty() -> None:
                tidy()
                announce()

            Supervisor(programs, duty).run()
    finally:
        if redis is not None:
            redis.remove()


def _check_redis(url: str) -> None:
    """Raises InvalidRequest if no Redis answers: without one the service would start, and take no job."""
    redis = connect_redis(url)
    try:
        redis.ping()
    except RedisError as error:  # its text has the address, and no password
        detail = f"no Redis answers there ({error}); start it, or unset the variable, and serve brings one"
        raise InvalidRequest("SCENE_ATTACK_REDIS_URL", detail) from error
    finally:
        redis.close()


def _api(values: Settings, listener: socket.socket) -> Program:
    # The supervisor owns the socket. It stays open while the API restarts, so that requests wait instead of failing.
    fd = listener.fileno()
    command = program("scene_attack_api.main", str(fd))
    return Program("api", lambda: command, values.environ(), fds=[fd], silent_seconds=values.stall_seconds)


def _reachable(host: str) -> str:
    if host in ("", "0.0.0.0", "::"):
        return "127.0.0.1"
    return f"[{host}]" if ":" in host else host


class _Announcement:
    """Prints "ready URL" on stdout, once, as soon as the service is ready."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._said = False

    def __call__(self) -> None:
        if self._said:
            return
        try:
            ready = httpx.get(f"{self._url}/readyz", timeout=2.0, trust_env=False).status_code == 200
        except httpx.HTTPError:
            return
        if ready:
            self._said = True
            print(f"ready {self._url}", flush=True)


LOCK_FILE = "serve.lock"
_UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)


class ServiceLock:
    """The lock of a data folder, a context manager. No child process inherits it, and it ends with this process.

    Raises InvalidRequest("--data"), with process and address of the other service, if one runs on the folder; also if
    the folder cannot be written. A file system without locks is logged, and the service starts.
    """

    def __init__(self, folder: Path) -> None:
        try:
            # the file is not opened for writing only, or what the other service wrote would be gone
            self._file = (folder / LOCK_FILE).open("a+")
        except OSError as error:
            detail = f"{folder / LOCK_FILE} cannot be written ({error.strerror}); name another folder"
            raise InvalidRequest("--data", detail) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            with self._file:
                raise InvalidRequest("--data", f"a service runs on {folder} already, {self._other()}") from error
        except OSError as error:
            if error.errno not in _UNSUPPORTED:
                raise
            log.warning("no lock on the data folder: see to it that no other service uses it", error=error.strerror)
        self.tell(None)

    def tell(self, url: str | None) -> None:
        """Writes this process and its URL, None as long as there is none, for a service that is refused."""
        self._file.truncate(0)  # writing appends
        self._file.write(json.dumps({"pid": os.getpid(), "url": url}))
        self._file.flush()

    def _other(self) -> str:
        self._file.seek(0)
        try:
            other = json.load(self._file)
        except ValueError:  # it is being written
            return "which is just starting; stop it, or name another folder"
        address = "which is starting" if other["url"] is None else f"at {other['url']}"
        return f"process {other['pid']} {address}; use that one, stop it, or name another folder"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: type[BaseException] | None, _error: object, _trace: TracebackType | None) -> None:
        self._file.close()


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
