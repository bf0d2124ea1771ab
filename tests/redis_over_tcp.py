"""A real Redis on loopback as other machines would reach it: over TCP, with a password."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from redis import Redis
from redis.exceptions import ConnectionError as Away

from scene_attack_worker.stack import find_server
from tests.postgresql import free_port

PASSWORD = "p@ss/word"
QUOTED = "p%40ss%2Fword"


@contextmanager
def running() -> Iterator[int]:
    """Starts a server and ends it on leaving. Yields its port."""
    port = free_port()
    command = [find_server(), "--bind", "127.0.0.1", "--port", str(port), "--save", "", "--requirepass", PASSWORD]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        try:
            while not _answers(port):
                assert process.poll() is None, "Redis did not start"
            yield port
        finally:
            process.terminate()


def url(port: int) -> str:
    return f"redis://:{QUOTED}@127.0.0.1:{port}/0"


def _answers(port: int) -> bool:
    with suppress(Away), Redis(port=port, password=PASSWORD) as client:
        return bool(client.ping())
    return False
