import gc
import os
import secrets
import subprocess
import time
from collections.abc import Iterator
from importlib.util import find_spec
from typing import cast

import pytest
import structlog
from redis import Redis
from redis.exceptions import RedisError

from scene_attack import owner
from scene_attack.runs.set_up import set_up
from scene_attack_service.settings import Settings
from scene_attack_worker.stack import EmbeddedRedis
from tests import object_store, postgresql
from tests.postgresql import Postgresql

# Torch has one thread in every process of the tests: in this one, from when it is imported, in those that a test
# starts, and in those that follow the setting. So the two processes of `scripts/test` do not fight for cores, and all
# name the same backend, of which the number of threads is a part.
for variable in ("OMP_NUM_THREADS", "SCENE_ATTACK_THREADS"):
    os.environ.setdefault(variable, "1")

# Tests have the logs of a process that configures none, but for the local variables in its tracebacks: the catalogue is
# among them, and takes half a minute to write.
structlog.configure(
    processors=[
        *structlog.get_config()["processors"][:-1],
        structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback),
    ]
)

set_up(Settings())

# The thread of the tests is the one that draws, also for `sa.attack`, whose own thread would keep OpenGL from the rest.
owner._here.owns = True  # noqa: SLF001

# What is imported and made while tests are collected is no garbage: to look for some took a third of the time of it.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


QUESTIONS = find_spec("scene_attack_questions") is not None
"""Whether the plug-in is installed. All else can be tested without it, but for the documentation, which is of both."""
OF_QUESTIONS = ["unit/questions", "unit/training/iep", "unit/api/test_dashboard_questions.py", "unit/docs"]
collect_ignore = [] if QUESTIONS else OF_QUESTIONS

SERVERS = {"postgresql_server", "redis_url", "s3_server"}
"""Fixtures that start a server."""
SERVED = {"postgresql", "S3"}
"""Values of parameters for which a fixture asks for one of these by its name."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the tests that start a server as slow, and skips those of questions where they are not installed."""
    for item in items:
        if not QUESTIONS and (item.get_closest_marker("questions") or "vqa" in item.name):  # examples/*vqa*.json
            item.add_marker(pytest.mark.skip(reason="scene_attack_questions is not installed"))
        function = cast("pytest.Function", item)
        values = function.callspec.params.values() if hasattr(function, "callspec") else ()
        if SERVERS & set(function.fixturenames) or any(value in SERVED for value in values if isinstance(value, str)):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def redis_url() -> Iterator[str]:
    """The embedded Redis, as `serve` runs it."""
    server = EmbeddedRedis()
    with subprocess.Popen(server.program().command(), stdout=subprocess.DEVNULL) as process:
        with Redis.from_url(server.url) as client:
            deadline = time.monotonic() + 300  # seconds; a loaded machine takes long to start a process
            while not _answers(client):
                assert time.monotonic() < deadline
                time.sleep(0.01)
        yield server.url
        process.terminate()
    server.remove()


@pytest.fixture(scope="session")
def postgresql_server() -> Iterator[Postgresql]:
    with postgresql.running() as server:
        yield server


@pytest.fixture(scope="session")
def postgresql_database(postgresql_server: Postgresql) -> str:
    """The name of a database with the tables."""
    return postgresql_server.migrated()


@pytest.fixture
def postgresql_url(postgresql_server: Postgresql, postgresql_database: str) -> str:
    """The URL of a PostgreSQL database with the tables and no rows."""
    postgresql_server.empty(postgresql_database)
    return postgresql_server.url(postgresql_database)


@pytest.fixture
def children_of_tests(monkeypatch: pytest.MonkeyPatch, pytestconfig: pytest.Config) -> None:
    """Processes of the product run modules of the tests, too, although they do not look in the current folder."""
    monkeypatch.setenv("PYTHONPATH", str(pytestconfig.rootpath))


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """A stand-in for S3, for this process and those that it starts; the URL of a bucket."""
    with object_store.running() as url, pytest.MonkeyPatch.context() as patch:
        for name, value in object_store.environ(url).items():
            patch.setenv(name, value)
        object_store.create_bucket(url)
        yield f"s3://{object_store.BUCKET}"


@pytest.fixture
def s3_url(s3_server: str) -> str:
    """The URL of an empty folder of the stand-in for S3."""
    return f"{s3_server}/{secrets.token_hex(4)}"


def _answers(client: Redis) -> bool:
    try:
        return bool(client.ping())
    except RedisError:
        return False
