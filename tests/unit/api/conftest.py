import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from scene_attack.runs.spec import parse
from scene_attack_api.main import create_app, server
from scene_attack_api.requests import Services
from scene_attack_service.jobs.models import Artifact
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from tests.unit.api.dashboard_records import open_record
from tests.unit.api.guarded import Guarded, guarding
from tests.unit.jobs.records import OUTCOME

SPHERE: dict[str, Any] = {
    "scene": {"camera": {"size": [32, 32]}, "objects": [{"mesh": "primitive/sphere"}]},
    "attack": {"renderer": "pyrender", "steps": 1, "queries": 20},
}


@pytest.fixture(scope="session")
def settings(redis_url: str, tmp_path_factory: pytest.TempPathFactory) -> Settings:
    """The settings of `app`."""
    return Settings(
        data=tmp_path_factory.mktemp("data"),
        redis_url=redis_url,
        max_upload_bytes=300_000,
        max_faces=5000,
        check_seconds=120,
    )


@pytest.fixture(scope="session")
def app(settings: Settings) -> FastAPI:
    """The real app with database, Redis and warm processes, and no worker: jobs stay queued."""
    return create_app(settings)


@contextmanager
def serving(app: FastAPI) -> Iterator[httpx.Client]:
    """Serves an app, and gives a client of it, over HTTP."""
    listener = socket.create_server(("127.0.0.1", 0))
    made = server(app)
    thread = threading.Thread(target=made.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{listener.getsockname()[1]}", timeout=300) as client:
            assert client.get("/healthz").status_code == 200  # the socket listens: it waits until the app has started
            yield client
    finally:
        made.should_exit = True
        thread.join()
        listener.close()


@pytest.fixture(scope="session")
def client(app: FastAPI) -> Iterator[httpx.Client]:
    """A client of the app, over HTTP. The app has no key, so it needs none."""
    with serving(app) as client:
        yield client


@pytest.fixture(scope="session")
def guarded(redis_url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A service that has keys, with a record of its own."""
    app = create_app(Settings(data=tmp_path_factory.mktemp("data"), redis_url=redis_url, hosts="service.example"))
    with serving(app) as client, guarding(app, client) as guarded:
        yield guarded


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    """An empty record."""
    with open_record(tmp_path) as made:
        yield made


@pytest.fixture
def services(app: FastAPI, client: httpx.Client) -> Services:  # noqa: ARG001 - it starts the app
    found = app.state.services
    assert isinstance(found, Services)
    return found


@pytest.fixture
def finished(services: Services, tmp_path: Path) -> str:
    """A job with one artifact, run by hand through the record."""
    job, _ = services.record.jobs.create(parse(SPHERE), 1000, None, lambda _: {})
    assert job is not None
    job_id = job.id
    (tmp_path / "original.png").write_bytes(b"0123456789")
    stored = services.store.put(tmp_path / "original.png")
    attempt = services.record.leases.lease(job_id, "test", 60)
    assert attempt is not None
    services.record.leases.progress(attempt, "attacking", 1, 2, [{"step": 1}])
    file = Artifact(job_id=job_id, name="original.png", sha256=stored.sha256, media_type="image/png", size=stored.size)
    services.record.leases.succeed(attempt, {}, OUTCOME, [file])
    return job_id
