"""Where the service may listen: other machines reach it only once there is a key."""

import os
import socket

from services.access.keys import AccessKeys
from services.addresses import is_loopback
from services.errors import InvalidRequest
from services.jobs.database import connect, migrate
from services.settings import Settings


def check_listening(settings: Settings) -> None:
    """Raises InvalidRequest("--host") if other machines reach the settings' address and there is no key."""
    host = settings.host
    if is_loopback(host):
        return
    engine = connect(settings)
    try:
        migrate(engine, settings)
        has_key = AccessKeys(engine).exist()
    finally:
        engine.dispose()
    if not has_key:
        raise InvalidRequest(
            "--host",
            f"at {host or 'every address'} other machines reach the service, and it has no key yet, so anybody could "
            "use it; make one with `scene-attack keys create NAME --scope admin` (in a container: `docker compose run "
            "--rm api scene-attack keys create NAME --scope admin`), or listen on 127.0.0.1",
        )


def listen(host: str, port: int) -> socket.socket:
    """Opens a listening socket; port 0 stands for any free port. Raises InvalidRequest("--port") if that cannot be."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
        detail = f"cannot listen on {host}:{port} ({reason}); try --port 0"
        raise InvalidRequest("--port", detail) from error
