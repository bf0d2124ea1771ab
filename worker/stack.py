"""`scene-attack serve`: runs Redis (unless a URL is set), the API and the workers; they start and stop together."""

import socket
import sys

import httpx
from redis.exceptions import RedisError
from sqlalchemy import Engine

from services.access.listening import check_listening, listen
from services.device import check_device
from services.errors import InvalidRequest
from services.jobs.database import connect as connect_database
from services.jobs.database import migrate
from services.jobs.queue import connect as connect_redis
from services.jobs.record import Record
from services.logs import configure, logger
from services.process import use
from services.settings import Settings
from worker.main import housekeeping, workers
from worker.redis_server import EmbeddedRedis, remove_abandoned
from worker.service_lock import ServiceLock
from worker.supervisor import Program, Supervisor

log = logger(__name__)


def serve(values: Settings) -> int:
    """Runs the whole service until SIGTERM or SIGINT; prints "ready URL" once it takes jobs. Returns the exit status.

    Raises InvalidRequest if the address is taken or the device of the settings is not there, if other machines reach
    the address and there is no key, and if another service runs on the data folder.
    """
    use(values)
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


def _run(values: Settings, engine: Engine, lock: ServiceLock) -> None:
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
    command = [sys.executable, "-m", "api.main", str(fd)]
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
