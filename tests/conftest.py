import subprocess
import time
from collections.abc import Iterator

import pytest
from redis import Redis
from redis.exceptions import RedisError

from worker.redis_server import EmbeddedRedis


@pytest.fixture(scope="session")
def redis_url() -> Iterator[str]:
    """The embedded Redis, as `serve` runs it."""
    server = EmbeddedRedis()
    with subprocess.Popen(server.program().command(), stdout=subprocess.DEVNULL) as process:
        with Redis.from_url(server.url) as client:
            deadline = time.monotonic() + 10
            while not _answers(client):
                assert time.monotonic() < deadline
                time.sleep(0.01)
        yield server.url
        process.terminate()
    server.remove()


def _answers(client: Redis) -> bool:
    try:
        return bool(client.ping())
    except RedisError:
        return False
